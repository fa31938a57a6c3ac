"""Turn a PLY mesh into points: its vertices where they are dense, else samples of its faces."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.options import METRES_PER_UNIT
from panoloc.core.scan.color_range import ColorRange
from panoloc.core.scan.companions import companion
from panoloc.core.scan.mesh.sampling import iter_surface_samples
from panoloc.core.scan.mesh.surface import (
    Paint,
    SurfacePart,
    TextureReader,
    check_vertex_numbers,
    fan_of,
    in_fans,
    triangle_areas,
)
from panoloc.core.scan.ply.body import PlyBody, RowBatch, convert_colors
from panoloc.core.scan.ply.header import POSITION_NAMES, PlyElement, PlyHeader
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, stack_columns

# Above these counts the vertices of any room lie closer than its points are thinned to; the faces are not even read.
MAX_VERTICES = 2_000_000
MAX_FACES = 5_000_000
# Vertices farther apart than this leave holes in synthetic views.
SPARSE_SPACING_M = 0.02
_INDEX_NAMES = ("vertex_indices", "vertex_index")
# Texture coordinates: a list per face, or two properties per vertex. The faces may name one of several textures.
_PER_CORNER = "texcoord"
_PER_VERTEX = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_TEXTURE_NUMBER = "texnumber"


@dataclass(frozen=True)
class _Faces:
    """triangles: (T, 3) vertex numbers. uv: (T, 3, 2), v up. textures: (T,) numbers. colors: (T, 3), raw.

    uv and colors are empty where the file has none.
    """

    triangles: NDArray[np.int64]
    uv: NDArray[np.float64]
    textures: NDArray[np.int64]
    colors: NDArray[Any]


def has_mesh(header: PlyHeader) -> bool:
    """Tell whether the faces of the file may be needed besides its vertices."""
    vertices, faces = header.element("vertex"), header.element("face")
    if vertices is None or faces is None or _index_name(faces) is None:
        return False
    return vertices.count <= MAX_VERTICES and 0 < faces.count <= MAX_FACES


def has_face_colors(header: PlyHeader) -> bool:
    """Tell whether the faces can give the colours that the vertices lack."""
    faces = header.element("face")
    return has_mesh(header) and faces is not None and faces.color_names is not None


def texture_names(header: PlyHeader) -> list[str]:
    """Return the names of the texture files that the comments of the header give."""
    pairs = (comment.partition(" ") for comment in header.comments)
    return [name.strip() for word, _, name in pairs if word.lower() == "texturefile" and name.strip()]


def has_texture(header: PlyHeader) -> bool:
    """Tell whether the faces have textures and say where each corner lies in them."""
    return bool(texture_names(header)) and has_mesh(header) and (_is_per_corner(header) or _uv_names(header) != ())


def read_mesh(context: ReadingContext, header: PlyHeader, body: PlyBody, *, is_textured: bool) -> Iterator[RawChunk]:
    """Yield points on the surface of a mesh; the diagnostics say which. Raises ScanDamagedError and ScanContentError."""
    rows, faces = _load(header, body)
    vertices = header.element("vertex")
    assert vertices is not None
    positions = stack_columns(rows, POSITION_NAMES, np.float64)
    check_vertex_numbers(faces.triangles, len(positions), "vertex")
    if is_textured:
        yield from iter_surface_samples(_textured_parts(context, header, rows, faces), context)
        return
    names = vertices.color_names
    areas = triangle_areas(positions, faces.triangles)
    spacing_m = float(np.sqrt(areas.sum() / len(positions))) * METRES_PER_UNIT[context.options.unit]
    if names and (spacing_m <= SPARSE_SPACING_M or not areas.any()):
        colors = convert_colors(rows, vertices, names)
        context.note("mesh_vertices_used", f"A mesh: its {len(positions):,} vertices are dense enough as points.")
        for start in range(0, len(positions), CHUNK_ROWS):
            part = slice(start, start + CHUNK_ROWS)
            yield RawChunk(positions[part], colors[part], min(1.0, (start + CHUNK_ROWS) / len(positions)))
        return
    if names:
        paint = Paint(vertex_colors=_unit_range(convert_colors(rows, vertices, names)))
    else:
        paint = Paint(triangle_colors=_unit_range(faces.colors))
    yield from iter_surface_samples([SurfacePart(positions, faces.triangles, paint)], context)


def _textured_parts(
    context: ReadingContext, header: PlyHeader, rows: NDArray[np.void], faces: _Faces
) -> list[SurfacePart]:
    reader = TextureReader()
    textures = [reader.read(companion(context, name, "texture").read_bytes(), name) for name in texture_names(header)]
    if not len(faces.triangles):
        raise ScanContentError("The PLY mesh has a texture, but no faces. Export the scan again.")
    check_vertex_numbers(faces.textures, len(textures), "texture")
    if _is_per_corner(header):
        uv = faces.uv
    else:
        uv = np.stack([rows[name].astype(np.float64) for name in _uv_names(header)], axis=1)[faces.triangles]
    uv = uv * [1.0, -1.0] + [0.0, 1.0]  # counted from the lower edge
    positions = stack_columns(rows, POSITION_NAMES, np.float64)
    numbers = [faces.textures == number for number in range(len(textures))]
    return [
        SurfacePart(positions, faces.triangles[chosen], Paint(texture, uv[chosen]))
        for chosen, texture in zip(numbers, textures, strict=True)
        if chosen.any()
    ]


def _unit_range(raw: NDArray[Any]) -> NDArray[np.float64]:
    """Return raw colours in 0..1, whatever their range."""
    colors = ColorRange()
    colors.observe(raw[np.isfinite(raw).all(axis=1)])
    colors.check()
    return colors.to_bytes(raw) / 255.0


def _load(header: PlyHeader, body: PlyBody) -> tuple[NDArray[np.void], _Faces]:
    rows, faces = None, None
    for element in header.elements:
        if element.name == "vertex":
            names = [*POSITION_NAMES, *(element.color_names or ()), *_uv_names(header)]
            rows = np.concatenate(list(body.iter_scalars(element, names)))
        elif element.name == "face":
            batches = [batch for block in body.iter_rows(element) for batch in block]
            faces = _Faces(*map(np.concatenate, zip(*(_triangles(batch, element) for batch in batches), strict=True)))
        else:
            body.skip(element)
        if rows is not None and faces is not None:
            return rows, faces
    raise AssertionError("a mesh has vertices and faces; see has_mesh")


def _triangles(batch: RowBatch, element: PlyElement) -> tuple[NDArray[Any], ...]:
    """Return the faces of equally many corners as the fields of `_Faces`: a polygon becomes a fan of triangles."""
    records, names = batch.records, batch.records.dtype.names or ()
    index_name = _index_name(element)
    assert index_name is not None
    corners = records[index_name]
    if corners.dtype.kind == "f":
        corners = np.nan_to_num(corners, nan=-1.0).clip(-1, MAX_VERTICES)
    fan = fan_of(corners.shape[1])
    uv, textures, colors = np.empty((0, 3, 2)), np.zeros(len(records), np.int64), np.empty((0, 3))
    if _PER_CORNER in names:
        places = records[_PER_CORNER].astype(np.float64).reshape(len(records), -1)
        if places.shape[1] != 2 * corners.shape[1]:
            raise ScanDamagedError(
                f"A face of the PLY mesh has {corners.shape[1]} corners, but {places.shape[1]} texture coordinates; "
                "expected two per corner. Export the scan again."
            )
        uv = in_fans(places.reshape(len(records), -1, 2), fan)
    if _TEXTURE_NUMBER in names:
        textures = records[_TEXTURE_NUMBER].astype(np.int64)
    if element.color_names is not None:
        colors = np.tile(convert_colors(records, element, element.color_names), (len(fan), 1))
    return in_fans(corners.astype(np.int64), fan), uv, np.tile(textures, len(fan)), colors


def _is_per_corner(header: PlyHeader) -> bool:
    faces = header.element("face")
    return faces is not None and any(prop.name == _PER_CORNER and prop.count_type for prop in faces.properties)


def _uv_names(header: PlyHeader) -> tuple[str, ...]:
    vertices = header.element("vertex")
    names = vertices.scalars.keys() if vertices is not None else set()
    return next((pair for pair in _PER_VERTEX if names >= set(pair)), ())


def _index_name(faces: PlyElement) -> str | None:
    lists = {prop.name for prop in faces.properties} - faces.scalars.keys()
    return next((name for name in _INDEX_NAMES if name in lists), None)
