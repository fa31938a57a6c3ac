"""Storage of scans, maps and batches: files under keys such as `maps/map_x/1/scan.ply`, in a folder or a bucket."""

from panoloc.service.storage.folder import FolderStorage
from panoloc.service.storage.protocol import Stamp, Storage
from panoloc.service.storage.urls import BUCKET_SCHEMES, BucketAccess, folder_of, split_url

__all__ = ["BucketAccess", "FolderStorage", "Stamp", "Storage", "open_storage"]


def open_storage(url: str, access: BucketAccess | None = None) -> Storage:
    """Return the storage behind a path or a URL. access: to the bucket, if it is one. Raises ValueError for what is neither."""
    if split_url(url)[0] not in BUCKET_SCHEMES:
        return FolderStorage(folder_of(url))
    assert access is not None
    # Only here: processes with a folder do without obstore.
    from panoloc.service.storage.bucket import BucketStorage

    return BucketStorage(url, access)
