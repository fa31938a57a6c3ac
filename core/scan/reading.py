"""Read a scan of any known format into a bounded, coloured point cloud in metres, z up.

A zip holds one scan with the files that it refers to, or several scans in one frame, which become one cloud.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from panoloc.core.errors import ScanContentError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.sandbox import SandboxLimits
from panoloc.core.scan.collecting import ScanCollector
from panoloc.core.scan.e57.reader import read_e57
from panoloc.core.scan.format_detection import (
    HEAD_BYTES,
    KNOWN_FORMATS,
    detect_format,
    extension_of,
    is_named_like_a_scan,
)
from panoloc.core.scan.gltf.reader import read_gltf
from panoloc.core.scan.las import read_las
from panoloc.core.scan.obj import read_obj
from panoloc.core.scan.pcd import read_pcd
from panoloc.core.scan.ply.reader import read_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.ptx import read_ptx
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, ScanReader
from panoloc.core.scan.sandbox.reading import read_in_sandbox
from panoloc.core.scan.text.reader import detect_layout, read_text
from panoloc.core.scan.unpacking import unpacked

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
Progress = Callable[[float], None]
Given = TypeVar("Given", bound=str)
# Points as text take a second of a processor for a few megabytes.
_CPU_S_PER_BYTE = 2e-6
_SHARE_OF_READING = 0.95
_SHARE_OF_UNPACKING = 0.2
# Files that scans refer to, or that come with them for people.
_COMPANIONS = {
    *(".mtl", ".bin", ".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tga", ".tif", ".tiff", ".ktx2"),
    *(".pdf", ".html", ".md", ".xml", ".json", ".prj", ".log", ".doc", ".docx"),
}
# What the whole map says of itself in place of its parts.
_OF_THE_WHOLE = {"large_coordinates", "suspicious_extent"}


def read_scan(
    path: Path,
    options: ScanOptions | None = None,
    progress: Progress | None = None,
    temporary: Callable[[], Path] | None = None,
) -> PointCloud:
    """Read the scan at `path`, thin it to `options.max_points_used` and bring it to metres, z up.

    progress: called with 0..1 after every chunk; its exceptions pass through. temporary: returns the folder in which
    archives are unpacked, called for archives alone; by default the system's.

    Raises ScanFormatError, ScanDamagedError or ScanContentError with what was expected, what came and what to do;
    errors of a scan in a zip begin with the name of its file.
    """
    options, path = options or ScanOptions(), Path(path)
    report = progress or (lambda fraction: None)
    report(0.0)
    if detect_format(path, options.format)[0] != "zip":
        return _read_file(path, options, report)
    below = temporary() if temporary else Path(tempfile.gettempdir())
    with unpacked(path, lambda share: report(_SHARE_OF_UNPACKING * share), below) as folder:
        scans = _scans_in(folder)
        if len(scans) == 1:
            return _read_member(scans[0], folder, options, _part(report, 0, 1))
        return _read_together(scans, folder, path, options, report)


def read_points_of_map(path: Path, max_points_used: int = ScanOptions.max_points_used) -> PointCloud:
    """Read the points that the service keeps of a map: in metres, z up. To guess that again would shrink a hall as if it was in feet."""
    return read_scan(path, ScanOptions(unit="m", up_axis="z", max_points_used=max_points_used))


def iter_chunks(name: str, context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the raw points of a scan of the format `name`."""
    # A PLY that came with other files may have textures.
    is_apart = name in SANDBOXED or (name == "ply" and context.folder is not None) or context.options.from_strangers
    if not is_apart:
        return READERS[name](context)
    cpu_s = SandboxLimits.cpu_s + int(_CPU_S_PER_BYTE * context.size_bytes)
    return read_in_sandbox(name, context, SandboxLimits(cpu_s=cpu_s))


def _read_file(
    path: Path, options: ScanOptions, report: Progress, folder: Path | None = None, is_part: bool = False
) -> PointCloud:
    """Read one file. folder: the files that it may refer to lie below it. is_part: see `ReadingContext`."""
    name, remark = detect_format(path, options.format)
    context = ReadingContext(path, options, path.stat().st_size, folder=folder, is_part=is_part)
    if remark:
        context.note("extension_mismatch", remark, "warning")
    collector = ScanCollector(context)
    for chunk in iter_chunks(name, context):
        collector.add(chunk)
        report(_SHARE_OF_READING * min(max(chunk.fraction, 0.0), 1.0))
    cloud = collector.finish()
    report(1.0)
    return cloud


def _read_together(
    scans: list[Path], folder: Path, archive: Path, options: ScanOptions, report: Progress
) -> PointCloud:
    # Every scan is brought to metres and z up by itself, as far as something says how.
    whole = replace(
        options,
        unit=_known(options.unit, "m"),
        height_unit="auto",
        up_axis=_known(options.up_axis, "z"),
        coordinate_system=None,
    )
    context = ReadingContext(archive, whole, archive.stat().st_size)
    collector = ScanCollector(context)
    systems: dict[str | None, str] = {}
    for number, scan in enumerate(scans):
        cloud = _read_member(scan, folder, options, _part(report, number, len(scans)), is_part=True)
        _say_as(cloud, context)
        name = _name(scan, folder)
        systems.setdefault(cloud.coordinate_system, name)
        for found in cloud.diagnostics:
            if found.code not in _OF_THE_WHOLE:
                context.note(found.code, f"{name}: {found.message}", found.severity)
        positions = cloud.positions.astype(np.float64) + cloud.origin_offset
        collector.add(RawChunk(positions, cloud.colors, 1.0), cloud.num_points_read)
    system = _common_system(systems, context)
    context.note(
        "scans_merged",
        f"{len(scans)} scans of the zip were merged: {', '.join(_name(scan, folder) for scan in scans)[:500]}.",
    )
    # Each scan was held against its own, in its own unit.
    cloud = replace(collector.finish(), coordinate_system=system)
    report(1.0)
    return cloud


def _common_system(systems: dict[str | None, str], context: ReadingContext) -> str | None:
    """Return the system that all scans name. systems: each with the first scan that names it; None: scans without one."""
    named = {system: name for system, name in systems.items() if system is not None}
    if len(named) > 1:
        listed = ", ".join(f"{name}: {system[:60]}" for system, name in named.items())
        raise ScanContentError(
            f"The scans of the zip are in different coordinate systems ({listed}). Convert them to one system and "
            "pack them again."
        )
    system = next(iter(named), None)
    if system is not None and None in systems:
        context.note(
            "coordinate_system_assumed",
            f"{systems[None]} has no usable coordinate system; it is assumed to be in {system[:60]}, as "
            f"{named[system]} says.",
            "warning",
        )
    return system


def _known(given: Given, used: Given) -> Given:
    """Return what is known of the whole when each scan was read as was given."""
    return given if given == "auto" else used


def _say_as(part: PointCloud, context: ReadingContext) -> None:
    """Let the whole say what a part says of its unit and axes, which it has brought to metres and z up."""
    if part.read_as is not None and part.read_as.unit_from == "file":
        context.unit = "m"
    if part.read_as is not None and part.read_as.up_axis_from == "file":
        context.up_axis = "z"


def _read_member(scan: Path, folder: Path, options: ScanOptions, report: Progress, is_part: bool = False) -> PointCloud:
    try:
        return _read_file(scan, replace(options, format=None), report, folder=folder, is_part=is_part)
    except ScanError as error:
        raise type(error)(f"{_name(scan, folder)}: {error}") from error


def _scans_in(folder: Path) -> list[Path]:
    """Return the files that are scans. Raises ScanContentError without one, and for archives in archives."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    found = [path for path in files if _is_scan(path, folder)]
    if not found:
        held = ", ".join(_name(path, folder) for path in files)[:300] or "nothing"
        raise ScanContentError(f"The zip holds no scan; expected {KNOWN_FORMATS}. It holds {held}.")
    return found


def _is_scan(path: Path, folder: Path) -> bool:
    if extension_of(path.name) in _COMPANIONS:
        return False
    try:
        name, _ = detect_format(path, None)
        if name == "text":
            with path.open("rb") as stream:
                detect_layout(stream.read(16 * HEAD_BYTES))
    except ScanError as error:
        if is_named_like_a_scan(path.name):
            raise type(error)(f"{_name(path, folder)}: {error}") from error
        return False
    if name == "zip":
        raise ScanContentError(
            f"The zip holds another zip, {_name(path, folder)!r}. Pack the scans directly into one zip."
        )
    return True


def _name(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()[:100]


def _part(report: Progress, number: int, count: int) -> Progress:
    """Return the progress of scan `number` of `count`, after unpacking."""
    return lambda share: report(_SHARE_OF_UNPACKING + (1 - _SHARE_OF_UNPACKING) * (number + share) / count)
