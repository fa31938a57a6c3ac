"""Read E57 scans with pye57: several scans with their poses become one cloud."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, CoreError, ScanContentError, ScanDamagedError, ScanFormatError
from panoloc.core.scan.e57.coloring import ImageColors, with_poses
from panoloc.core.scan.e57.images import images_of, pose_of
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error

_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_POSITIONS = (("cartesianX", "cartesianY", "cartesianZ"), _SPHERICAL)
_INVALID_FLAGS = ("cartesianInvalidState", "sphericalInvalidState", "isColorInvalid")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
# Announced maxima are often those of the data; the depth is the next usual one.
_COLOR_DEPTHS = (255.0, 1023.0, 4095.0, 65535.0)


class _Scan:
    """One scan, or station: wraps a `data3D` node of libE57."""

    def __init__(self, node: Any):
        from pye57 import libe57

        self._libe57, self._node = libe57, node
        self._points = node["points"]
        self._prototype = libe57.StructureNode(self._points.prototype())
        self.num_points = int(self._points.childCount())
        self.field_names = [self._prototype[i].elementName() for i in range(self._prototype.childCount())]

    @property
    def has_color(self) -> bool:
        """Tell whether every point has red, green and blue."""
        return set(_COLORS) <= set(self.field_names)

    def color_range(self) -> float | None:
        """Return the largest value that the colours can have, or None where the file does not say."""
        red = self._prototype["colorRed"]
        announced = [float(red.maximum())] if isinstance(red, self._libe57.IntegerNode) else []
        if isinstance(red, self._libe57.ScaledIntegerNode):
            announced = [float(red.scaledMaximum())]
        if self._node.isDefined("colorLimits"):
            limits = self._node["colorLimits"]
            names = [f"{color}Maximum" for color in _COLORS]
            announced += [float(limits[name].value()) for name in names if limits.isDefined(name)]
        largest = max(announced, default=0.0)
        if not 0 < largest <= _COLOR_DEPTHS[-1]:
            return None
        if largest <= 1 and not isinstance(red, self._libe57.IntegerNode):
            return 1.0
        return next(depth for depth in _COLOR_DEPTHS if largest <= depth)

    def iter_points(self, image_file: Any) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Yield positions in the file's frame, NaN where the scanner calls them invalid, and colours, each (n, 3).

        Of a scan without colours those are (n, 0).
        """
        position_names = next((each for each in _POSITIONS if set(each) <= set(self.field_names)), None)
        if position_names is None:
            raise ScanContentError(
                f"A scan of the E57 file has no coordinates; it has {', '.join(self.field_names)[:200]}."
            )
        flags = [name for name in _INVALID_FLAGS if name in self.field_names]
        rotation, translation = pose_of(self._node)
        color_names = _COLORS if self.has_color else ()
        capacity = min(CHUNK_ROWS, self.num_points)
        columns = {name: np.empty(capacity) for name in (*position_names, *color_names, *flags)}
        buffers = self._libe57.VectorSourceDestBuffer()
        for name, column in columns.items():
            buffers.append(self._libe57.SourceDestBuffer(image_file, name, column, capacity, True, True))
        reader = self._points.reader(buffers)
        try:
            num_done = 0
            while num_rows := reader.read():
                num_done += num_rows
                rows = {name: column[:num_rows] for name, column in columns.items()}
                positions = np.stack([rows[name] for name in position_names], axis=1)
                if position_names == _SPHERICAL:
                    positions = _cartesian(*positions.T)
                for flag in flags:
                    positions[rows[flag] != 0] = np.nan
                colors = np.empty((num_rows, len(color_names)))
                for channel, name in enumerate(color_names):
                    colors[:, channel] = rows[name]
                yield positions @ rotation.T + translation, colors
        finally:
            reader.close()
        if num_done < self.num_points:
            raise ScanDamagedError(
                f"A scan of the E57 file announces {self.num_points:,} points but holds {num_done:,}. {CUT_SHORT}"
            )


def _cartesian(
    distance: NDArray[np.float64], azimuth: NDArray[np.float64], elevation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return positions (n, 3) by ASTM E2807: azimuth from +x, elevation from the horizontal plane."""
    level = distance * np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


def read_e57(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of all coloured scans in the file's frame; without colours, those that its own images see.

    Raises ScanDamagedError for a short file or a wrong checksum, ScanContentError without scans, points or colour.
    """
    context.unit = "m"  # ASTM E2807
    with opened(context) as image_file:
        root = image_file.root()
        if root.isDefined("coordinateMetadata"):
            context.coordinate_system = str(root["coordinateMetadata"].value()).strip() or None
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
        reason = (str(error).strip().splitlines() or ["unknown error"])[0][:200]
        raise ScanDamagedError(f"The E57 file is damaged: {reason}. {CUT_SHORT}") from error
    finally:
        if image_file is not None:
            image_file.close()


def _iter_file(context: ReadingContext, image_file: Any) -> Iterator[RawChunk]:
    root = image_file.root()
    nodes = root["data3D"] if root.isDefined("data3D") else ()
    scans = [scan for number in range(len(nodes)) if (scan := _Scan(nodes[number])).num_points]
    if not scans:
        raise ScanContentError(f"The E57 file holds no points (scans in it: {len(nodes)}). Export the scan again.")
    colored = [scan for scan in scans if scan.has_color]
    if not colored:
        yield from _colored_by_images(context, scans, image_file)
        return
    context.note_scans(len(scans), len(colored), "scans")
    total = sum(scan.num_points for scan in colored)
    context.check_point_count(total)
    dtype, factors = _color_scales(colored)
    num_done = 0
    for scan, factor in zip(colored, factors, strict=True):
        for positions, colors in scan.iter_points(image_file):
            num_done += len(positions)
            if dtype.kind != "f":
                colors = np.rint(np.nan_to_num(colors) * factor).clip(0, np.iinfo(dtype).max).astype(dtype)
            yield RawChunk(positions, colors, num_done / total)


def _colored_by_images(context: ReadingContext, scans: list[_Scan], image_file: Any) -> Iterator[RawChunk]:
    """Yield the points that the file's own images see, in the colours that those show; reads the points twice."""
    images, num_others = images_of(image_file.root())
    posed = with_poses(images)
    if not posed:
        fields, count = ", ".join(scans[0].field_names)[:200], len(images) + num_others
        if count:
            fields += f", and {count} images, but none that is readable and has a pose, which colouring needs"
        raise no_color_error(fields)
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


def _color_scales(scans: list[_Scan]) -> tuple[np.dtype[Any], list[float]]:
    """Return the type of the raw colours for all scans, and the factor for each."""
    ranges = [scan.color_range() for scan in scans]
    known = [top for top in ranges if top is not None]
    if len(known) < len(ranges):  # nothing announced: the values decide
        return np.dtype(np.float64), [1.0] * len(ranges)
    if set(known) == {65535.0}:  # may still be 8-bit colour; see ColorRange
        return np.dtype(np.uint16), [1.0] * len(ranges)
    return np.dtype(np.uint8), [255.0 / top for top in known]
