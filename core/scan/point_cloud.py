"""A coloured point cloud in metres, z up: what every scan reader returns."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.scan.frame import ReadAs


@dataclass(frozen=True)
class Diagnostic:
    """Something that the operator should know about a scan.

    code: stable snake_case name; severity: "info" or "warning"; message: a sentence for people. question: of a doubt that the operator
    can end: `text`, and `choices`, each with `label`, `patch` (body of `PATCH /maps/{id}`), `storey_height_m` and `extent_m`.
    """

    code: str
    severity: str
    message: str
    question: dict[str, Any] | None = None


@dataclass(frozen=True)
class PointCloud:
    """Points of a scan in the map frame (metres, right-handed, z up).

    positions: (N, 3) float32, relative to `origin_offset`.
    colors: (N, 3) uint8, RGB; for semantic scans the colour codes of the labels.
    origin_offset: (3,) float64, metres; add it to a position to get the scan's own coordinates.
    num_points_read: points in the file before dropping and thinning.
    diagnostics: what was converted, dropped or looks suspicious.
    coordinate_system: of positions with their offset, as "EPSG:25832" or WKT, where the file says so. read_as: unit and axes of the
    file, None of clouds that come from no file.
    """

    positions: NDArray[np.float32]
    colors: NDArray[np.uint8]
    origin_offset: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    num_points_read: int = 0
    diagnostics: tuple[Diagnostic, ...] = ()
    coordinate_system: str | None = None
    read_as: ReadAs | None = None

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the smallest and largest coordinates, each (3,), relative to `origin_offset`."""
        return self.positions.min(axis=0), self.positions.max(axis=0)
