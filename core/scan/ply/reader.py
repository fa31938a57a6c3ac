"""Read PLY scans: points with colour, meshes whose faces are sampled, or Gaussian splats."""

from collections.abc import Iterator

import numpy as np

from panoloc.core.errors import ScanContentError
from panoloc.core.scan.ply.body import PlyBody
from panoloc.core.scan.ply.columns import POSITION_NAMES, color_names, convert_colors
from panoloc.core.scan.ply.header import PlyElement, PlyHeader, check_file_size, read_ply_header
from panoloc.core.scan.ply.mesh import has_face_colors, has_mesh, has_texture, read_mesh, texture_names
from panoloc.core.scan.ply.splats import has_splats, iter_splats
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, no_color_error, stack_columns


def read_ply(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a PLY file in chunks.

    Raises ScanDamagedError when the file is shorter than its header says or a row does not fit it, ScanContentError
    without vertices, coordinates or colour.
    """
    with context.path.open("rb") as stream:
        header = read_ply_header(stream)
        vertices = _checked_vertices(context, header)
        surplus = check_file_size(header, context.size_bytes)
        if surplus is not None:
            context.note("surplus_bytes", surplus, "warning")
        body = PlyBody(stream, header)
        if has_splats(header):
            yield from iter_splats(context, header, vertices, body)
        elif has_mesh(header):
            yield from read_mesh(context, header, body, is_textured=_is_textured(context, header))
        else:
            yield from _iter_vertices(header, vertices, body)


def _iter_vertices(header: PlyHeader, vertices: PlyElement, body: PlyBody) -> Iterator[RawChunk]:
    for element in header.elements:
        if element is vertices:
            break
        body.skip(element)
    names = color_names(vertices)
    assert names is not None
    num_done = 0
    for rows in body.iter_scalar_rows(vertices, [*POSITION_NAMES, *names]):
        num_done += len(rows)
        positions = stack_columns(rows, POSITION_NAMES, np.float64)
        yield RawChunk(positions, convert_colors(rows, vertices, names), num_done / vertices.count)


def _is_textured(context: ReadingContext, header: PlyHeader) -> bool:
    """Textures can only be read where they came with the file; colours of vertices stand in for them elsewhere."""
    return context.folder is not None and has_texture(header)


def _checked_vertices(context: ReadingContext, header: PlyHeader) -> PlyElement:
    vertices = header.element("vertex")
    if vertices is None:
        raise ScanContentError("The PLY file holds no points: there is no 'vertex' element. Export the scan again.")
    context.check_point_count(vertices.count)
    is_splats = has_splats(header)
    scalars = [prop.name for prop in vertices.properties if prop.count_type is None]
    if not set(POSITION_NAMES) <= set(scalars):
        raise ScanContentError(
            f"The PLY vertices have no x, y and z; they have {', '.join(scalars)[:200] or 'nothing'}."
        )
    is_colored = is_splats or _is_textured(context, header)
    if not is_colored and color_names(vertices) is None and not has_face_colors(header):
        hint = "; if it has a texture image, upload both in one zip" if texture_names(header) else ""
        raise no_color_error(f"{', '.join(scalars)[:200]}{hint}")
    return vertices
