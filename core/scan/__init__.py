"""Readers of scan files, each returning a `core.scan.point_cloud.PointCloud`.

`read_scan` is the one entry: it finds the format out, streams the file in chunks and thins while it reads.
"""

from core.scan.options import ScanOptions
from core.scan.ply.writer import encode_ply, write_ply
from core.scan.reading import read_scan
from core.scan.voxel_thinning import thin_cloud

__all__ = ["ScanOptions", "encode_ply", "read_scan", "thin_cloud", "write_ply"]
