"""Where scans, map records and batches live: files under keys such as `maps/map_x/1/scan.ply`, in a folder or in a bucket."""

from service.storage.folder import FolderStorage
from service.storage.opening import BucketAccess, open_storage
from service.storage.protocol import Stamp, Storage

__all__ = ["BucketAccess", "FolderStorage", "Stamp", "Storage", "open_storage"]
