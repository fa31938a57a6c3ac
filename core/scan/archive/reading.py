"""Read a zip archive: one scan with its companions, or several scans that become one map."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from panoloc.core.errors import ScanContentError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.archive.unpacking import unpacked
from panoloc.core.scan.collecting import ScanCollector
from panoloc.core.scan.format_detection import (
    HEAD_BYTES,
    KNOWN_FORMATS,
    detect_format,
    extension_of,
    is_named_like_a_scan,
)
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.readers import read_file
from panoloc.core.scan.reading_context import RawChunk, ReadingContext
from panoloc.core.scan.text.layout import detect_layout

_SHARE_OF_UNPACKING = 0.2
# Files that scans refer to, or that come with them for people.
_COMPANIONS = {
    *(".mtl", ".bin", ".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tga", ".tif", ".tiff", ".ktx2"),
    *(".pdf", ".html", ".md", ".xml", ".json", ".prj", ".log", ".doc", ".docx"),
}
# What the whole map says of itself in place of its parts.
_OF_THE_WHOLE = {"large_coordinates", "suspicious_extent"}


def read_archive(path: Path, options: ScanOptions, report: Callable[[float], None], temporary: Path) -> PointCloud:
    """Read all scans of the archive at `path`, unpacked below `temporary`, each with its own reader, in one frame.

    Raises as `panoloc.core.scan.reading.read_scan` does; errors of a scan begin with the name of its file.
    """
    with unpacked(path, lambda share: report(_SHARE_OF_UNPACKING * share), temporary) as folder:
        scans = _scans_in(folder)
        if len(scans) == 1:
            return _read_member(scans[0], folder, options, _part(report, 0, 1))
        return _read_together(scans, folder, path, options, report)


def _read_together(
    scans: list[Path], folder: Path, archive: Path, options: ScanOptions, report: Callable[[float], None]
) -> PointCloud:
    # Every scan is brought to metres and z up by itself.
    context = ReadingContext(archive, replace(options, unit="m", up_axis="z"), archive.stat().st_size)
    collector = ScanCollector(context)
    systems: dict[str | None, str] = {}
    for number, scan in enumerate(scans):
        cloud = _read_member(scan, folder, options, _part(report, number, len(scans)))
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


def _read_member(scan: Path, folder: Path, options: ScanOptions, report: Callable[[float], None]) -> PointCloud:
    try:
        return read_file(scan, replace(options, format=None), report, folder=folder)
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


def _part(report: Callable[[float], None], number: int, count: int) -> Callable[[float], None]:
    """Return the progress of scan `number` of `count`, after unpacking."""
    rest = 1 - _SHARE_OF_UNPACKING
    return lambda share: report(_SHARE_OF_UNPACKING + rest * (number + share) / count)
