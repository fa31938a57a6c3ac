"""Turn a coloured PLY mesh into points: its vertices where they are dense, samples of its faces where they are not."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanDamagedError
from core.options import METRES_PER_UNIT
from core.scan.mesh.sampling import barycentric_weights, num_samples_on
from core.scan.mesh.surface import triangle_areas
from core.scan.ply.body import PlyBody
from core.scan.ply.columns import POSITION_NAMES, color_names, convert_colors
from core.scan.ply.header import PlyElement, PlyHeader
from core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, stack_columns

# Above these counts the vertices of any room lie closer than its points are thinned to; the faces are not even read.
MAX_VERTICES = 2_000_000
MAX_FACES = 5_000_000
# Vertices farther apart than this leave holes in synthetic views.
SPARSE_SPACING_M = 0.02
_INDEX_NAMES = ("vertex_indices", "vertex_index")


@dataclass(frozen=True)
class _Mesh:
    """positions: (V, 3). triangles: (T, 3) vertex numbers. Colours per vertex, (V, 3), or else per triangle, (T, 3)."""

    positions: NDArray[np.float64]
    triangles: NDArray[np.int64]
    vertex_colors: NDArray[Any] | None
    triangle_colors: NDArray[Any] | None


def has_mesh(header: PlyHeader) -> bool:
    """Tell whether the faces of the file may be needed besides its vertices."""
    vertices, faces = header.element("vertex"), header.element("face")
    if vertices is None or faces is None or index_name(faces) is None:
        return False
    return vertices.count <= MAX_VERTICES and 0 < faces.count <= MAX_FACES


def has_face_colors(header: PlyHeader) -> bool:
    """Tell whether the faces can give the colours that the vertices lack."""
    faces = header.element("face")
    return has_mesh(header) and faces is not None and color_names(faces) is not None


def read_mesh(context: ReadingContext, header: PlyHeader, body: PlyBody) -> Iterator[RawChunk]:
    """Yield points on the surface of a mesh; which ones is noted in the diagnostics."""
    mesh = _load(header, body)
    areas = triangle_areas(mesh.positions, mesh.triangles)
    metres = METRES_PER_UNIT[context.options.unit]
    spacing_m = float(np.sqrt(areas.sum() / len(mesh.positions))) * metres
    is_dense = spacing_m <= SPARSE_SPACING_M or not areas.any()
    if is_dense and mesh.vertex_colors is not None:
        context.note("mesh_vertices_used", f"A mesh: its {len(mesh.positions):,} vertices are dense enough as points.")
        for start in range(0, len(mesh.positions), CHUNK_ROWS):
            part = slice(start, start + CHUNK_ROWS)
            fraction = min(1.0, (start + CHUNK_ROWS) / len(mesh.positions))
            yield RawChunk(mesh.positions[part], mesh.vertex_colors[part], fraction)
        return
    num_samples = num_samples_on(float(areas.sum()), context)
    context.note(
        "mesh_sampled",
        f"A mesh with {len(mesh.positions):,} vertices about {spacing_m:.3g} m apart and {len(mesh.triangles):,} "
        f"triangles: {num_samples:,} points were sampled on its faces.",
    )
    yield from _iter_samples(mesh, areas, num_samples, is_label=context.options.color_kind == "labels")


def _load(header: PlyHeader, body: PlyBody) -> _Mesh:
    positions, colors, faces = np.empty((0, 3)), None, None
    for element in header.elements:
        if element.name == "vertex":
            positions, colors = _load_vertices(element, body)
        elif element.name == "face":
            faces = _load_faces(element, body)
        else:
            body.skip(element)
        if faces is not None and len(positions):
            break
    triangles, triangle_colors = faces or (np.empty((0, 3), np.int64), None)
    outside = (triangles < 0) | (triangles >= len(positions))
    if outside.any():
        raise ScanDamagedError(
            f"A face refers to vertex {triangles[outside][0]}, but there are {len(positions):,} vertices. "
            "The mesh is damaged; export it again."
        )
    return _Mesh(positions, triangles, colors, triangle_colors)


def _load_vertices(element: PlyElement, body: PlyBody) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
    names = color_names(element)
    rows = list(body.iter_scalar_rows(element, [*POSITION_NAMES, *(names or ())]))
    positions = np.concatenate([stack_columns(part, POSITION_NAMES, np.float64) for part in rows])
    colors = np.concatenate([convert_colors(part, element, names) for part in rows]) if names else None
    return positions, colors


def _load_faces(element: PlyElement, body: PlyBody) -> tuple[NDArray[np.int64], NDArray[Any] | None]:
    corners_name, names = index_name(element), color_names(element)
    assert corners_name is not None
    triangles: list[NDArray[np.int64]] = [np.empty((0, 3), np.int64)]
    colors: list[NDArray[Any]] = []
    for batches in body.iter_list_rows(element):
        for batch in batches:
            corners = batch.records[corners_name]
            if corners.dtype.kind == "f":
                corners = np.nan_to_num(corners, nan=-1.0).clip(-1, MAX_VERTICES)
            corners = corners.astype(np.int64)
            for last in range(2, corners.shape[1]):  # a polygon becomes a fan
                triangles.append(corners[:, [0, last - 1, last]])
                if names:
                    colors.append(convert_colors(batch.records, element, names))
    return np.concatenate(triangles), np.concatenate(colors) if colors else None


def _iter_samples(mesh: _Mesh, areas: NDArray[np.float64], num_samples: int, is_label: bool) -> Iterator[RawChunk]:
    ends = np.cumsum(areas)
    for start in range(0, num_samples, CHUNK_ROWS):
        numbers = np.arange(start, min(start + CHUNK_ROWS, num_samples))
        chosen = np.searchsorted(ends, (numbers + 0.5) * (ends[-1] / num_samples))
        chosen = np.minimum(chosen, len(areas) - 1)
        weights = barycentric_weights(numbers)
        corners = mesh.triangles[chosen]
        positions = np.einsum("nk,nkd->nd", weights, mesh.positions[corners])
        yield RawChunk(positions, _sample_colors(mesh, chosen, corners, weights, is_label), numbers[-1] / num_samples)


def _sample_colors(
    mesh: _Mesh,
    chosen: NDArray[np.int64],
    corners: NDArray[np.int64],
    weights: NDArray[np.float64],
    is_label: bool,
) -> NDArray[Any]:
    colors: NDArray[Any]
    if mesh.vertex_colors is None:
        assert mesh.triangle_colors is not None
        colors = mesh.triangle_colors[chosen]
    elif is_label:
        nearest = np.argmax(weights, axis=1)
        colors = mesh.vertex_colors[corners[np.arange(len(corners)), nearest]]
    else:
        colors = np.einsum("nk,nkd->nd", weights, mesh.vertex_colors[corners])
        if mesh.vertex_colors.dtype.kind == "u":
            colors = np.rint(colors).astype(mesh.vertex_colors.dtype)
    return colors


def index_name(faces: PlyElement) -> str | None:
    """Return the property of faces that holds the numbers of their vertices, None without one."""
    lists = {prop.name for prop in faces.properties if prop.count_type is not None}
    return next((name for name in _INDEX_NAMES if name in lists), None)
