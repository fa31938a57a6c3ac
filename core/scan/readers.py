"""Which reader reads which format, and which of them in a process of its own even where the file is trusted."""

from collections.abc import Iterator

from core.scan.box.boxed_reading import read_in_box
from core.scan.box.limits import BoxLimits
from core.scan.e57.reader import read_e57
from core.scan.gltf.reader import read_gltf
from core.scan.las import read_las
from core.scan.obj.reader import read_obj
from core.scan.pcd import read_pcd
from core.scan.ply.reader import read_ply
from core.scan.ptx import read_ptx
from core.scan.reading_context import RawChunk, ReadingContext, ScanReader
from core.scan.text.reader import read_text

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
BOXED = frozenset({"gltf", "obj", "e57", "las"})
"""Formats of many parts that refer to each other and hold pictures, or whose parser is a native one for all of the file."""


# Points as text take a second of a processor for a few megabytes.
_CPU_S_PER_BYTE = 2e-6


def iter_chunks(name: str, context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the raw points of a scan of the format `name`."""
    # A PLY that came with other files may have textures.
    is_apart = name in BOXED or (name == "ply" and context.folder is not None) or context.options.from_strangers
    if not is_apart:
        return READERS[name](context)
    return read_in_box(name, context, BoxLimits(cpu_s=BoxLimits.cpu_s + int(_CPU_S_PER_BYTE * context.size_bytes)))
