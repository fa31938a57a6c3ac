"""Surfaces with colours and textures, sampled evenly: what the readers of meshes have in common."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.options import MAX_PIXELS
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error

Wrap = Literal["repeat", "clamp", "mirror"]
_TEXTURE_FORMATS = ("JPEG", "PNG", "WEBP", "BMP", "TGA", "TIFF")

# Samples are this close, where they need not be fewer.
SAMPLE_SPACING_M = 0.01
# Samples are thinned to even spacing afterwards; that needs more of them than remain.
SAMPLES_PER_KEPT_POINT = 4
MIN_SAMPLES = 1000
# Steps of the R2 low-discrepancy sequence (Roberts 2018): even without a random generator.
_R2_STEPS = (0.7548776662466927, 0.5698402909980532)


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

    def read(self, data: bytes, name: str) -> Texture:
        """Return an image file as a texture. Raises ScanDamagedError and ScanContentError, with `name`."""
        from PIL import Image

        try:
            with Image.open(io.BytesIO(data), formats=_TEXTURE_FORMATS) as image:
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
            reason = (str(error).strip() or type(error).__name__).splitlines()[0][:120]
            raise ScanDamagedError(
                f"The texture {name[:100]} cannot be read ({reason}); expected JPEG, PNG, WebP, BMP, TGA or TIFF. "
                "Export the scan again."
            ) from error
        return Texture(pixels)


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


def iter_surface_samples(parts: Sequence[SurfacePart], context: ReadingContext) -> Iterator[RawChunk]:
    """Yield points spread evenly over all parts, colours uint8; of parts without triangles, their vertices.

    Raises ScanContentError for surfaces without colours or without extent.
    """
    surfaces = [part for part in parts if len(part.triangles)]
    points = [part for part in parts if not len(part.triangles) and len(part.positions)]
    if not surfaces and not points:
        raise ScanContentError(
            "The file holds no surface: there are no triangles and no points. Export the scan again."
        )
    factors = {tuple(np.rint(part.paint.factor * 255).tolist()) for part in (*surfaces, *points)}
    if all(part.paint.is_plain for part in (*surfaces, *points)) and len(factors) == 1:
        raise no_color_error("neither textures nor colours on its vertices or materials")
    is_label = context.options.color_kind == "labels"
    for part in points:
        for start in range(0, len(part.positions), CHUNK_ROWS):
            corners = np.arange(start, min(start + CHUNK_ROWS, len(part.positions)))[:, None]
            colors, _ = _colors(part.paint, corners[:, 0], corners, np.ones((len(corners), 1)), is_label)
            yield RawChunk(part.positions[corners[:, 0]], colors, 0.5)
    if not surfaces:
        return
    areas = [triangle_areas(part.positions, part.triangles) for part in surfaces]
    total = float(sum(each.sum() for each in areas))
    if not total > 0:
        raise ScanContentError("The surface of the mesh has no extent: all of its triangles are flat or not finite.")
    most = SAMPLES_PER_KEPT_POINT * min(context.options.max_points_used, context.options.max_points)
    wanted = total * (context.sampled_metres / SAMPLE_SPACING_M) ** 2
    num_samples = int(min(max(wanted, MIN_SAMPLES), most))
    num_triangles = sum(len(each) for each in areas)
    context.note(
        "mesh_sampled", f"A mesh with {num_triangles:,} triangles: {num_samples:,} points were sampled on its faces."
    )
    yield from _iter_samples(surfaces, areas, total / num_samples, is_label)


def _barycentric_weights(numbers: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the weights of the three corners, (n, 3), for samples by their numbers, (n,): even over each triangle."""
    first, second = ((numbers * step) % 1.0 for step in _R2_STEPS)
    folded = first + second > 1
    first, second = np.where(folded, 1 - first, first), np.where(folded, 1 - second, second)
    return np.stack([1 - first - second, first, second], axis=1)


def _iter_samples(
    parts: list[SurfacePart], areas: list[NDArray[np.float64]], area_per_sample: float, is_label: bool
) -> Iterator[RawChunk]:
    done, total = 0.0, sum(each.sum() for each in areas)
    for part, part_areas in zip(parts, areas, strict=True):
        ends = done + np.cumsum(part_areas)
        # Sample k lies (k + 1/2) shares from the beginning of all surfaces, so that small parts get their share too.
        first, last = (int(np.ceil(edge / area_per_sample - 0.5)) for edge in (done, ends[-1]))
        for start in range(first, last, CHUNK_ROWS):
            numbers = np.arange(start, min(start + CHUNK_ROWS, last))
            chosen = np.searchsorted(ends, (numbers + 0.5) * area_per_sample).clip(0, len(part_areas) - 1)
            weights = _barycentric_weights(numbers)
            corners = part.triangles[chosen]
            positions = np.einsum("nk,nkd->nd", weights, part.positions[corners])
            colors, is_solid = _colors(part.paint, chosen, corners, weights, is_label)
            yield RawChunk(positions[is_solid], colors[is_solid], float(numbers[-1] * area_per_sample / total))
        done = float(ends[-1])


def _colors(
    paint: Paint, chosen: NDArray[np.int64], corners: NDArray[np.int64], weights: NDArray[np.float64], is_label: bool
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the colours of samples, (n, 3), and which of them are surface."""
    if is_label:  # codes of classes are never mixed
        weights = (np.arange(weights.shape[1]) == np.argmax(weights, axis=1)[:, None]).astype(np.float64)
    layers = []
    is_solid = np.ones(len(chosen), np.bool_)
    if paint.texture is not None and paint.uv is not None:
        uv = np.einsum("nk,nkd->nd", weights, paint.uv[chosen])
        rgba = paint.texture.colors_at(uv, interpolated=not is_label) / 255
        layers.append(rgba[:, :3])
        is_solid = rgba[:, 3] >= paint.alpha_cutoff
    if paint.vertex_colors is not None:
        layers.append(np.einsum("nk,nkd->nd", weights, paint.vertex_colors[corners]))
    if paint.triangle_colors is not None:
        layers.append(paint.triangle_colors[chosen])
    if not layers or np.any(paint.factor != 1):
        layers.append(np.broadcast_to(paint.factor, (len(chosen), 3)))
    # Several are multiplied as light.
    light = [_srgb_to_linear(layer) for layer in layers] if len(layers) > 1 else []
    mixed = linear_to_srgb(np.prod(light, axis=0)) if light else layers[0]
    return np.rint(np.nan_to_num(mixed).clip(0, 1) * 255).astype(np.uint8), is_solid


def _srgb_to_linear(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return light for stored values, both 0..1 (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return stored values for light, both 0..1."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


def _wrapped(along: NDArray[np.float64], wrap: Wrap) -> NDArray[np.float64]:
    if wrap == "clamp":
        return along.clip(0.0, 1.0)
    if wrap == "mirror":
        return 1.0 - np.abs(along % 2.0 - 1.0)
    # Corners at 1 mean the far edge, not the near one.
    return np.where((along >= 0) & (along <= 1), along, along % 1.0)
