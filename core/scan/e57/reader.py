"""Read E57 scans with pye57: several scans with their poses become one cloud."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, CoreError, ScanContentError, ScanDamagedError, ScanFormatError
from panoloc.core.scan.e57.coloring import ImageColors, with_poses
from panoloc.core.scan.e57.images import images_of
from panoloc.core.scan.e57.scan_entry import E57Scan
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, no_color_error


def read_e57(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of all coloured scans in the file's frame; without colours, those that its own images see.

    Raises ScanDamagedError for a short file or a wrong checksum, ScanContentError without scans, points or colour.
    """
    with opened(context) as image_file:
        context.coordinate_system = _coordinate_system(image_file.root())
        yield from _iter_file(context, image_file)


@contextmanager
def opened(context: ReadingContext) -> Iterator[Any]:
    """Give the `libe57.ImageFile` of a file. Raises as `read_e57` does."""
    try:
        from pye57 import libe57
    except ImportError as error:
        raise ScanFormatError(
            "E57 files cannot be read here: the package pye57 is not installed (it has no build for this machine). "
            "Convert the scan to PLY or LAZ."
        ) from error
    image_file = None
    try:
        image_file = libe57.ImageFile(str(context.path), "r")
        yield image_file
    except (CoreError, OSError):
        raise
    except Exception as error:  # E57Exception, and what the bindings raise for nodes of an unexpected kind
        raise ScanDamagedError(f"The E57 file is damaged: {_first_line(error)}. {CUT_SHORT}") from error
    finally:
        if image_file is not None:
            image_file.close()


def _iter_file(context: ReadingContext, image_file: Any) -> Iterator[RawChunk]:
    scans = _scans(image_file)
    if not any(scan.has_color for scan in scans):
        yield from _colored_by_images(context, scans, image_file)
        return
    num_scans = len(scans)
    scans = [scan for scan in scans if scan.has_color]
    context.note_scans(num_scans, len(scans), "scans")
    total = sum(scan.num_points for scan in scans)
    context.check_point_count(total)
    dtype, factors = _color_scales(scans)
    num_done = 0
    for scan, factor in zip(scans, factors, strict=True):
        for positions, colors in scan.iter_points(image_file):
            num_done += len(positions)
            yield RawChunk(positions, _scale_colors(colors, factor, dtype), num_done / total)


def _coordinate_system(root: Any) -> str | None:
    if not root.isDefined("coordinateMetadata"):
        return None
    return str(root["coordinateMetadata"].value()).strip() or None


def _colored_by_images(context: ReadingContext, scans: list[E57Scan], image_file: Any) -> Iterator[RawChunk]:
    """Yield the points that the file's own images see, in the colours that those show; reads the points twice."""
    images, num_others = images_of(image_file.root())
    posed = with_poses(images)
    if not posed:
        fields, count = ", ".join(scans[0].field_names)[:200], len(images) + num_others
        beside = (
            f", and {count} images, but none that is readable and has a pose, which colouring needs" if count else ""
        )
        raise no_color_error(fields + beside)
    total = sum(scan.num_points for scan in scans)
    context.check_point_count(total)
    colors = ImageColors(posed)
    for scan in scans:
        for positions, _ in scan.iter_points(image_file):
            colors.add(positions)
    colors.close_gaps()
    num_done = num_seen = 0
    for scan in scans:
        for positions, _ in scan.iter_points(image_file):
            found, seen = colors.of(positions)
            num_done, num_seen = num_done + len(positions), num_seen + int(seen.sum())
            yield RawChunk(positions[seen], found[seen].astype(np.uint8), num_done / total)
    left_out = f", {len(images) - len(posed)} images were not used" if len(posed) < len(images) else ""
    context.note(
        "colored_by_images",
        f"The scan has no colours: {num_seen:,} of {total:,} points got colours from {len(posed)} images of the file; "
        f"points that no image sees were left out{left_out}.",
        "info" if num_seen > total // 2 else "warning",
    )


def _scans(image_file: Any) -> list[E57Scan]:
    """Return the scans that hold points. Raises ScanContentError where there is none."""
    from pye57 import libe57

    root = image_file.root()
    nodes = root["data3D"] if root.isDefined("data3D") else ()
    scans = [E57Scan(libe57, nodes[number]) for number in range(len(nodes))]
    scans = [scan for scan in scans if scan.num_points]
    if not scans:
        raise ScanContentError(f"The E57 file holds no points (scans in it: {len(nodes)}). Export the scan again.")
    return scans


def _color_scales(scans: list[E57Scan]) -> tuple[np.dtype[Any], list[float]]:
    """Return the type of the raw colours for all scans, and the factor for each."""
    ranges = [scan.color_range() for scan in scans]
    known = [top for top in ranges if top is not None]
    if len(known) < len(ranges):  # nothing announced: the values decide
        return np.dtype(np.float64), [1.0] * len(ranges)
    if set(known) == {65535.0}:  # may still be 8-bit colour; see ColorRange
        return np.dtype(np.uint16), [1.0] * len(ranges)
    return np.dtype(np.uint8), [255.0 / top for top in known]


def _scale_colors(colors: NDArray[np.float64], factor: float, dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind == "f":
        return colors
    scaled = np.rint(np.nan_to_num(colors) * factor)
    return np.clip(scaled, 0, np.iinfo(dtype).max).astype(dtype)


def _first_line(error: BaseException) -> str:
    return (str(error).strip().splitlines() or ["unknown error"])[0][:200]
