"""One scan (station) inside an E57 file: its fields, its pose, and its points in the file's frame."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanContentError, ScanDamagedError
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.reading_context import CHUNK_ROWS

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID_FLAGS = ("cartesianInvalidState", "sphericalInvalidState", "isColorInvalid")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
# Announced maxima are often those of the data; the depth is the next usual one.
_COLOR_DEPTHS = (255.0, 1023.0, 4095.0, 65535.0)


class E57Scan:
    """Wraps a `data3D` node of libE57. libe57: the module `pye57.libe57`."""

    def __init__(self, libe57: Any, node: Any):
        self._libe57 = libe57
        self._node = node
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
            announced += [float(limits[name].value()) for name in self._limit_names(limits)]
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
        position_names = self._position_names()
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
                positions = self._cartesian(columns, position_names, num_rows)
                for flag in flags:
                    positions[columns[flag][:num_rows] != 0] = np.nan
                colors = np.empty((num_rows, len(color_names)))
                for channel, name in enumerate(color_names):
                    colors[:, channel] = columns[name][:num_rows]
                yield positions @ rotation.T + translation, colors
        finally:
            reader.close()
        if num_done < self.num_points:
            raise ScanDamagedError(
                f"A scan of the E57 file announces {self.num_points:,} points but holds {num_done:,}. {CUT_SHORT}"
            )

    def _position_names(self) -> tuple[str, str, str]:
        for names in (_CARTESIAN, _SPHERICAL):
            if set(names) <= set(self.field_names):
                return names
        raise ScanContentError(
            f"A scan of the E57 file has no coordinates; it has {', '.join(self.field_names)[:200]}."
        )

    def _cartesian(
        self, columns: dict[str, NDArray[np.float64]], names: tuple[str, str, str], num_rows: int
    ) -> NDArray[np.float64]:
        first, second, third = (columns[name][:num_rows] for name in names)
        if names == _CARTESIAN:
            return np.stack([first, second, third], axis=1)
        level = first * np.cos(third)  # ASTM E2807: range, azimuth from +x, elevation from the horizontal plane
        return np.stack([level * np.cos(second), level * np.sin(second), first * np.sin(third)], axis=1)

    @staticmethod
    def _limit_names(limits: Any) -> list[str]:
        names = [f"{color}Maximum" for color in _COLORS]
        return [name for name in names if limits.isDefined(name)]


def pose_of(node: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation (3, 3) and translation (3,) from the frame of a scan or image to the file's; identity without a pose."""
    if not node.isDefined("pose"):
        return np.eye(3), np.zeros(3)
    pose = node["pose"]
    position, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if pose.isDefined("translation"):
        position = tuple(pose["translation"][axis].value() for axis in "xyz")
    if pose.isDefined("rotation"):
        turn = tuple(pose["rotation"][part].value() for part in "xyzw")
    if not 1e-6 < math.hypot(*turn) < math.inf:
        raise ScanDamagedError(
            "A scan or an image of the E57 file has a pose without a rotation. Export the scan again."
        )
    found = Pose.from_frame(position, turn, "ros")
    return found.rotation, found.position
