"""Read a scan of any known format into a bounded, coloured point cloud in metres, z up."""

import tempfile
from collections.abc import Callable
from pathlib import Path

from panoloc.core.options import ScanOptions
from panoloc.core.scan.archive.reading import read_archive
from panoloc.core.scan.format_detection import detect_format
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.readers import read_file


def read_scan(
    path: Path,
    options: ScanOptions | None = None,
    progress: Callable[[float], None] | None = None,
    temporary: Callable[[], Path] | None = None,
) -> PointCloud:
    """Read the scan at `path`, thin it to `options.max_points_used` and bring it to metres, z up.

    progress: called with 0..1 after every chunk; its exceptions pass through. temporary: returns the folder in which
    archives are unpacked, called for archives alone; by default the system's.

    Raises ScanFormatError, ScanDamagedError or ScanContentError with what was expected, what came and what to do.
    """
    options = options or ScanOptions()
    path = Path(path)
    report = progress or (lambda fraction: None)
    report(0.0)
    name, _ = detect_format(path, options.format)
    if name != "zip":
        return read_file(path, options, report)
    return read_archive(path, options, report, temporary() if temporary else Path(tempfile.gettempdir()))
