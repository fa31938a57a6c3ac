"""Read one scan file of any known format."""

from collections.abc import Callable
from pathlib import Path

from core.options import ScanOptions
from core.scan.collecting import ScanCollector
from core.scan.format_detection import detect_format
from core.scan.point_cloud import PointCloud
from core.scan.readers import iter_chunks
from core.scan.reading_context import ReadingContext

_SHARE_OF_READING = 0.95


def read_file(
    path: Path, options: ScanOptions, report: Callable[[float], None], folder: Path | None = None
) -> PointCloud:
    """Read the scan at `path` as `core.scan.reading.read_scan` does. folder: below which the files lie that it may refer to."""
    name, remark = detect_format(path, options.format)
    context = ReadingContext(path, options, path.stat().st_size, folder=folder)
    if remark:
        context.note("extension_mismatch", remark, "warning")
    collector = ScanCollector(context)
    for chunk in iter_chunks(name, context):
        collector.add(chunk)
        report(_SHARE_OF_READING * min(max(chunk.fraction, 0.0), 1.0))
    cloud = collector.finish()
    report(1.0)
    return cloud
