"""Triangles and what is painted on them: colours, and texture images, decoded within limits."""

import io
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.options import MAX_PIXELS

Wrap = Literal["repeat", "clamp", "mirror"]
_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TGA", "TIFF")


@dataclass(frozen=True)
class Texture:
    """pixels: (H, W, 4) uint8, RGBA. wrap: along u and v, what lies beyond 0..1."""

    pixels: NDArray[np.uint8]
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")

    def colors_at(self, uv: NDArray[np.float64], interpolated: bool = True) -> NDArray[np.float64]:
        """Return RGBA, (n, 4), 0..255, at places (n, 2): u to the right, v down, 0..1 from the upper left corner."""
        height, width = self.pixels.shape[:2]
        column = _wrapped(np.nan_to_num(uv[:, 0]), self.wrap[0]) * width - 0.5
        row = _wrapped(np.nan_to_num(uv[:, 1]), self.wrap[1]) * height - 0.5
        if not interpolated:
            return self._pixel(np.rint(row).astype(np.int64), np.rint(column).astype(np.int64))
        left, top = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
        right_share, low_share = (column - left)[:, None], (row - top)[:, None]
        upper = self._pixel(top, left) * (1 - right_share) + self._pixel(top, left + 1) * right_share
        lower = self._pixel(top + 1, left) * (1 - right_share) + self._pixel(top + 1, left + 1) * right_share
        return np.asarray(upper * (1 - low_share) + lower * low_share, np.float64)

    def _pixel(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.float64]:
        height, width = self.pixels.shape[:2]
        column = column % width if self.wrap[0] == "repeat" else column.clip(0, width - 1)
        row = row % height if self.wrap[1] == "repeat" else row.clip(0, height - 1)
        return np.asarray(self.pixels[row, column], np.float64)


class TextureReader:
    """Decodes the images of one scan. max_pixels: of all of them together."""

    def __init__(self, max_pixels: int = 4 * MAX_PIXELS) -> None:
        self._pixels_left = max_pixels

    def read(self, data: bytes, name: str, wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")) -> Texture:
        """Return an image file as a texture. Raises ScanDamagedError and ScanContentError, with `name`."""
        from PIL import Image

        try:
            with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
                width, height = image.size
                if width * height > min(self._pixels_left, MAX_PIXELS):
                    raise ScanContentError(
                        f"The texture {name[:100]} has {width:,} x {height:,} pixels, more than may be read "
                        f"({MAX_PIXELS:,} of one, {4 * MAX_PIXELS:,} of all). Export smaller textures."
                    )
                self._pixels_left -= width * height
                pixels = np.asarray(image.convert("RGBA"))
        except (ScanContentError, MemoryError):
            raise
        except Exception as error:  # Pillow's plugins raise what they like for damaged files
            reason = str(error).strip().splitlines()[0][:120] if str(error).strip() else type(error).__name__
            raise ScanDamagedError(
                f"The texture {name[:100]} cannot be read ({reason}); expected JPEG, PNG, WebP, BMP, TGA or TIFF. Export the scan again."
            ) from error
        return Texture(pixels, wrap)


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


def fan_of(num_corners: int) -> NDArray[np.int64]:
    """Return the triangles (t, 3), as numbers of corners, that make up a polygon."""
    last = np.arange(2, num_corners)
    return np.stack([np.zeros_like(last), last - 1, last], axis=1)


def in_fans(corners: NDArray[Any], fan: NDArray[np.int64]) -> NDArray[Any]:
    """Return what belongs to the corners of n polygons, (n, k, …), by triangles, (t · n, 3, …): first the first of each."""
    return np.swapaxes(corners[:, fan], 0, 1).reshape(-1, *fan.shape[1:], *corners.shape[2:])


def _wrapped(along: NDArray[np.float64], wrap: Wrap) -> NDArray[np.float64]:
    if wrap == "clamp":
        return along.clip(0.0, 1.0)
    if wrap == "mirror":
        return 1.0 - np.abs(along % 2.0 - 1.0)
    # Corners at 1 mean the far edge, not the near one.
    return np.where((along >= 0) & (along <= 1), along, along % 1.0)
