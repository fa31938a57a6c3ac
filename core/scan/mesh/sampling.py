"""Sample surfaces evenly, with the colours that are painted on them."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError
from panoloc.core.options import METRES_PER_UNIT
from panoloc.core.scan.mesh.surface import Paint, SurfacePart, triangle_areas
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error

# Samples are this close, where they need not be fewer.
SAMPLE_SPACING_M = 0.01
# Samples are thinned to even spacing afterwards; that needs more of them than remain.
SAMPLES_PER_KEPT_POINT = 4
MIN_SAMPLES = 1000
# Steps of the R2 low-discrepancy sequence (Roberts 2018): even without a random generator.
_R2_STEPS = (0.7548776662466927, 0.5698402909980532)


def _num_samples_on(area: float, context: ReadingContext) -> int:
    """Return how many samples a surface gets. area: in the file's own unit, squared."""
    metres = METRES_PER_UNIT[context.options.unit]
    most = SAMPLES_PER_KEPT_POINT * min(context.options.max_points_used, context.options.max_points)
    return int(min(max(area * (metres / SAMPLE_SPACING_M) ** 2, MIN_SAMPLES), most))


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
    _check_colors([*surfaces, *points])
    is_label = context.options.color_kind == "labels"
    for part in points:
        for start in range(0, len(part.positions), CHUNK_ROWS):
            corners = np.arange(start, min(start + CHUNK_ROWS, len(part.positions)))[:, None]
            colors, _ = _colors(part.paint, corners[:, 0], corners, np.ones((len(corners), 1)), is_label)
            yield RawChunk(part.positions[corners[:, 0]], colors, 0.5)
    areas = [triangle_areas(part.positions, part.triangles) for part in surfaces]
    if not surfaces:
        return
    total = float(sum(each.sum() for each in areas))
    if not total > 0:
        raise ScanContentError("The surface of the mesh has no extent: all of its triangles are flat or not finite.")
    num_samples = _num_samples_on(total, context)
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


def _check_colors(parts: list[SurfacePart]) -> None:
    factors = {tuple(np.rint(part.paint.factor * 255).tolist()) for part in parts}
    if all(part.paint.is_plain for part in parts) and len(factors) == 1:
        raise no_color_error("neither textures nor colours on its vertices or materials")


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
    mixed = layers[0] if len(layers) == 1 else _product(layers)
    return np.rint(np.nan_to_num(mixed).clip(0, 1) * 255).astype(np.uint8), is_solid


def _product(layers: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Multiply colours as light."""
    return linear_to_srgb(np.prod([srgb_to_linear(layer) for layer in layers], axis=0))


def srgb_to_linear(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return light for stored values, both 0..1 (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return stored values for light, both 0..1."""
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)
