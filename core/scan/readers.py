"""Which reader reads which format, which of them run in the sandbox, and how one file is read."""

from collections.abc import Callable, Iterator
from pathlib import Path

from panoloc.core.options import ScanOptions
from panoloc.core.scan.collecting import ScanCollector
from panoloc.core.scan.e57.reader import read_e57
from panoloc.core.scan.format_detection import detect_format
from panoloc.core.scan.gltf.reader import read_gltf
from panoloc.core.scan.las import read_las
from panoloc.core.scan.obj.reader import read_obj
from panoloc.core.scan.pcd import read_pcd
from panoloc.core.scan.ply.reader import read_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.ptx import read_ptx
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, ScanReader
from panoloc.core.scan.sandbox.limits import SandboxLimits
from panoloc.core.scan.sandbox.reading import read_in_sandbox
from panoloc.core.scan.text.reader import read_text

READERS: dict[str, ScanReader] = {
    "ply": read_ply,
    "pcd": read_pcd,
    "las": read_las,
    "e57": read_e57,
    "ptx": read_ptx,
    "gltf": read_gltf,
    "obj": read_obj,
    "text": read_text,
}
SANDBOXED = frozenset({"gltf", "obj", "e57", "las"})
"""Formats read in the sandbox even when the file is trusted: native parsers, or references between many parts."""
# Points as text take a second of a processor for a few megabytes.
_CPU_S_PER_BYTE = 2e-6
_SHARE_OF_READING = 0.95


def read_file(
    path: Path, options: ScanOptions, report: Callable[[float], None], folder: Path | None = None
) -> PointCloud:
    """Read one scan file as `panoloc.core.scan.reading.read_scan` does. folder: the files that it may refer to lie
    below it."""
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


def iter_chunks(name: str, context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the raw points of a scan of the format `name`."""
    # A PLY that came with other files may have textures.
    is_apart = name in SANDBOXED or (name == "ply" and context.folder is not None) or context.options.from_strangers
    if not is_apart:
        return READERS[name](context)
    cpu_s = SandboxLimits.cpu_s + int(_CPU_S_PER_BYTE * context.size_bytes)
    return read_in_sandbox(name, context, SandboxLimits(cpu_s=cpu_s))
