"""Read PLY scans: points with colour, meshes whose faces are sampled, or Gaussian splats."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.collecting import ColorRange
from panoloc.core.scan.mesh import (
    Paint,
    SurfacePart,
    TextureReader,
    check_vertex_numbers,
    fan_of,
    in_fans,
    iter_surface_samples,
    triangle_areas,
)
from panoloc.core.scan.ply.body import PlyBody, RowBatch, convert_colors
from panoloc.core.scan.ply.header import POSITION_NAMES, PlyElement, PlyHeader, check_file_size, read_ply_header
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error, stack_columns

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
MIN_OPACITY = 0.5
"""Of a splat on a surface. More transparent ones are haze between surfaces and cameras."""
_SPLAT_COLORS = ("f_dc_0", "f_dc_1", "f_dc_2")
_SH_C0 = 0.28209479177387814  # the constant harmonic, 1 / (2 sqrt(pi))


@dataclass(frozen=True)
class _Mesh:
    """Elements of a mesh. index_name: of the vertices of a face. is_per_corner: faces have texture coordinates.

    uv_names: of those of the vertices, empty without.
    """

    vertices: PlyElement
    faces: PlyElement
    index_name: str
    is_per_corner: bool
    uv_names: tuple[str, ...]


@dataclass(frozen=True)
class _Faces:
    """triangles: (T, 3) vertex numbers. uv: (T, 3, 2), v up. textures: (T,) numbers. colors: (T, 3), raw.

    uv and colors are empty where the file has none.
    """

    triangles: NDArray[np.int64]
    uv: NDArray[np.float64]
    textures: NDArray[np.int64]
    colors: NDArray[Any]


def read_ply(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a PLY file in chunks.

    Raises ScanDamagedError when the file is shorter than its header says or a row does not fit it, ScanContentError
    without vertices, coordinates or colour.
    """
    with context.path.open("rb") as stream:
        header = read_ply_header(stream)
        mesh, textures = _mesh_of(header), _texture_names(header)
        # Textures can only be read where they came with the file; colours of vertices stand in for them elsewhere.
        if mesh is None or context.folder is None or not (mesh.is_per_corner or mesh.uv_names):
            textures = []
        vertices = _checked_vertices(context, header, mesh, is_textured=bool(textures))
        surplus = check_file_size(header, context.size_bytes)
        if surplus is not None:
            context.note("surplus_bytes", surplus, "warning")
        body = PlyBody(stream, header)
        if mesh is not None and not _is_splats(vertices):
            yield from _iter_mesh(context, mesh, _load(header, mesh, body), textures)
            return
        for element in header.elements[: header.elements.index(vertices)]:
            body.skip(element)
        yield from _iter_splats(context, vertices, body) if _is_splats(vertices) else _iter_vertices(vertices, body)


def _iter_vertices(vertices: PlyElement, body: PlyBody) -> Iterator[RawChunk]:
    names, num_done = vertices.color_names, 0
    assert names is not None
    for rows in body.iter_scalars(vertices, [*POSITION_NAMES, *names]):
        num_done += len(rows)
        positions = stack_columns(rows, POSITION_NAMES, np.float64)
        yield RawChunk(positions, convert_colors(rows, vertices, names), num_done / vertices.count)


def _iter_splats(context: ReadingContext, vertices: PlyElement, body: PlyBody) -> Iterator[RawChunk]:
    """Yield the centres of splats that are opaque enough, with the colour that they have from all sides, uint8."""
    num_done, num_kept = 0, 0
    logit = float(np.log(MIN_OPACITY / (1 - MIN_OPACITY)))  # opacities are stored before the logistic function
    for rows in body.iter_scalars(vertices, [*POSITION_NAMES, *_SPLAT_COLORS, "opacity"]):
        num_done += len(rows)
        rows = rows[rows["opacity"] >= logit]
        num_kept += len(rows)
        harmonics = np.nan_to_num(stack_columns(rows, _SPLAT_COLORS, np.float64))
        colors = np.rint((0.5 + _SH_C0 * harmonics).clip(0, 1) * 255).astype(np.uint8)
        yield RawChunk(stack_columns(rows, POSITION_NAMES, np.float64), colors, num_done / vertices.count)
    if not num_kept:
        raise ScanContentError(
            f"None of the {num_done:,} Gaussian splats has an opacity of {MIN_OPACITY:g} or more. Export the scan again."
        )
    context.note(
        "splats_read",
        f"Gaussian splats: the centres of {num_kept:,} of {num_done:,} became points; the others are too "
        "transparent. Splats trained on photos alone have no metric scale and no vertical; the map is only as good "
        "as the positions in the file.",
    )


def _is_splats(vertices: PlyElement) -> bool:
    return vertices.scalars.keys() >= {*_SPLAT_COLORS, "opacity"}


def _checked_vertices(
    context: ReadingContext, header: PlyHeader, mesh: _Mesh | None, *, is_textured: bool
) -> PlyElement:
    vertices = header.element("vertex")
    if vertices is None:
        raise ScanContentError("The PLY file holds no points: there is no 'vertex' element. Export the scan again.")
    context.check_point_count(vertices.count)
    names = vertices.scalars
    if "packed_position" in names:
        raise ScanContentError(
            "The PLY holds Gaussian splats in a packed form. Export them unpacked, with x y z, f_dc_0 f_dc_1 f_dc_2 "
            "and opacity."
        )
    if not names.keys() >= set(POSITION_NAMES):
        raise ScanContentError(f"The PLY vertices have no x, y and z; they have {', '.join(names)[:200] or 'nothing'}.")
    has_color = is_textured or _is_splats(vertices) or vertices.color_names is not None
    if not has_color and (mesh is None or mesh.faces.color_names is None):
        hint = "; if it has a texture image, upload both in one zip" if _texture_names(header) else ""
        raise no_color_error(f"{', '.join(names)[:200]}{hint}")
    return vertices


def _texture_names(header: PlyHeader) -> list[str]:
    """Return the names of the texture files that the comments of the header give."""
    pairs = (comment.partition(" ") for comment in header.comments)
    return [name.strip() for word, _, name in pairs if word.lower() == "texturefile" and name.strip()]


def _mesh_of(header: PlyHeader) -> _Mesh | None:
    """Return the mesh whose faces may be needed besides its vertices, None without one."""
    vertices, faces = header.element("vertex"), header.element("face")
    if vertices is None or faces is None or vertices.count > MAX_VERTICES or not 0 < faces.count <= MAX_FACES:
        return None
    scalars, lists = vertices.scalars.keys(), {prop.name for prop in faces.properties} - faces.scalars.keys()
    index_name = next((name for name in _INDEX_NAMES if name in lists), None)
    uv_names = next((pair for pair in _PER_VERTEX if scalars >= set(pair)), ())
    return None if index_name is None else _Mesh(vertices, faces, index_name, _PER_CORNER in lists, uv_names)


def _iter_mesh(
    context: ReadingContext, mesh: _Mesh, loaded: tuple[NDArray[np.void], _Faces], textures: list[str]
) -> Iterator[RawChunk]:
    """Yield points on the surface of a mesh; the diagnostics say which. textures: names of files, those that are used."""
    rows, faces = loaded
    positions = stack_columns(rows, POSITION_NAMES, np.float64)
    check_vertex_numbers(faces.triangles, len(positions), "vertex")
    if textures:
        uv = faces.uv if mesh.is_per_corner else stack_columns(rows, mesh.uv_names, np.float64)[faces.triangles]
        yield from iter_surface_samples(_textured_parts(context, textures, positions, faces, uv), context)
        return
    names = mesh.vertices.color_names
    areas = triangle_areas(positions, faces.triangles)
    spacing_m = float(np.sqrt(areas.sum() / len(positions))) * context.sampled_metres
    if names and (spacing_m <= SPARSE_SPACING_M or not areas.any()):
        colors = convert_colors(rows, mesh.vertices, names)
        context.note("mesh_vertices_used", f"A mesh: its {len(positions):,} vertices are dense enough as points.")
        for start in range(0, len(positions), CHUNK_ROWS):
            part = slice(start, start + CHUNK_ROWS)
            yield RawChunk(positions[part], colors[part], min(1.0, (start + CHUNK_ROWS) / len(positions)))
        return
    if names:
        paint = Paint(vertex_colors=_unit_range(convert_colors(rows, mesh.vertices, names)))
    else:
        paint = Paint(triangle_colors=_unit_range(faces.colors))
    yield from iter_surface_samples([SurfacePart(positions, faces.triangles, paint)], context)


def _textured_parts(
    context: ReadingContext, names: list[str], positions: NDArray[np.float64], faces: _Faces, uv: NDArray[np.float64]
) -> list[SurfacePart]:
    reader = TextureReader()
    textures = [reader.read(context.companion(name, "texture").read_bytes(), name) for name in names]
    if not len(faces.triangles):
        raise ScanContentError("The PLY mesh has a texture, but no faces. Export the scan again.")
    check_vertex_numbers(faces.textures, len(textures), "texture")
    uv = uv * [1.0, -1.0] + [0.0, 1.0]  # counted from the lower edge
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


def _load(header: PlyHeader, mesh: _Mesh, body: PlyBody) -> tuple[NDArray[np.void], _Faces]:
    rows, faces = None, None
    for element in header.elements:
        if element is mesh.vertices:
            names = [*POSITION_NAMES, *(element.color_names or ()), *mesh.uv_names]
            rows = np.concatenate(list(body.iter_scalars(element, names)))
        elif element is mesh.faces:
            parts = [_triangles(batch, mesh) for block in body.iter_rows(element) for batch in block]
            faces = _Faces(*map(np.concatenate, zip(*parts, strict=True)))
        else:
            body.skip(element)
        if rows is not None and faces is not None:
            return rows, faces
    raise AssertionError("a mesh has vertices and faces")


def _triangles(batch: RowBatch, mesh: _Mesh) -> tuple[NDArray[Any], ...]:
    """Return the faces of equally many corners as the fields of `_Faces`: a polygon becomes a fan of triangles."""
    records, names = batch.records, batch.records.dtype.names or ()
    corners = records[mesh.index_name]
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
    if mesh.faces.color_names is not None:
        colors = np.tile(convert_colors(records, mesh.faces, mesh.faces.color_names), (len(fan), 1))
    return in_fans(corners.astype(np.int64), fan), uv, np.tile(textures, len(fan)), colors
