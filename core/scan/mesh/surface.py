"""Triangles and what is painted on them."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanDamagedError
from panoloc.core.scan.mesh.texture import Texture


@dataclass(frozen=True)
class Paint:
    """Colours of a part. Texture, colours of vertices and triangles, and factor are multiplied where present.

    texture with uv: (T, 3, 2) per corner. vertex_colors: (V, 3), triangle_colors: (T, 3), factor: (3,), all sRGB 0..1.
    alpha_cutoff: texture pixels below this alpha are no surface; 0: all are.
    """

    texture: Texture | None = None
    uv: NDArray[np.float64] | None = None
    vertex_colors: NDArray[np.float64] | None = None
    factor: NDArray[np.float64] = field(default_factory=lambda: np.ones(3))
    alpha_cutoff: float = 0.0
    triangle_colors: NDArray[np.float64] | None = None

    @property
    def is_plain(self) -> bool:
        """Tell whether the part has the same colour everywhere."""
        return self.texture is None and self.vertex_colors is None and self.triangle_colors is None


@dataclass(frozen=True)
class SurfacePart:
    """positions: (V, 3) in the file's frame. triangles: (T, 3) vertex numbers; none: the vertices are points."""

    positions: NDArray[np.float64]
    triangles: NDArray[np.int64]
    paint: Paint


def triangle_areas(positions: NDArray[np.float64], triangles: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the area of each triangle, (T,), zero where it is not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        corners = [positions[triangles[:, corner]] for corner in range(3)]
        areas = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axis=1) / 2
    return np.where(np.isfinite(areas), areas, 0.0)


def check_vertex_numbers(numbers: NDArray[np.int64], count: int, what: str) -> None:
    """Raise ScanDamagedError for faces that refer to something that is not there. what: such as "vertex"."""
    outside = (numbers < 0) | (numbers >= count)
    if outside.any():
        raise ScanDamagedError(
            f"A face refers to {what} {numbers[outside][0]}, but there are {count:,}, counted from 0. "
            "The mesh is damaged; export it again."
        )
