"""Read PLY scans: points with colour, meshes whose faces are sampled, or Gaussian splats."""

from collections.abc import Iterator

import numpy as np

from panoloc.core.errors import ScanContentError
from panoloc.core.scan.ply.body import PlyBody, convert_colors
from panoloc.core.scan.ply.header import POSITION_NAMES, PlyElement, PlyHeader, check_file_size, read_ply_header
from panoloc.core.scan.ply.mesh import has_face_colors, has_mesh, has_texture, read_mesh, texture_names
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, no_color_error, stack_columns

MIN_OPACITY = 0.5
"""Of a splat on a surface. More transparent ones are haze between surfaces and cameras."""
_SPLAT_COLORS = ("f_dc_0", "f_dc_1", "f_dc_2")
_SH_C0 = 0.28209479177387814  # the constant harmonic, 1 / (2 sqrt(pi))


def read_ply(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a PLY file in chunks.

    Raises ScanDamagedError when the file is shorter than its header says or a row does not fit it, ScanContentError
    without vertices, coordinates or colour.
    """
    with context.path.open("rb") as stream:
        header = read_ply_header(stream)
        # Textures can only be read where they came with the file; colours of vertices stand in for them elsewhere.
        is_textured = context.folder is not None and has_texture(header)
        vertices = _checked_vertices(context, header, is_textured)
        surplus = check_file_size(header, context.size_bytes)
        if surplus is not None:
            context.note("surplus_bytes", surplus, "warning")
        body = PlyBody(stream, header)
        if not _is_splats(vertices) and has_mesh(header):
            yield from read_mesh(context, header, body, is_textured=is_textured)
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


def _checked_vertices(context: ReadingContext, header: PlyHeader, is_textured: bool) -> PlyElement:
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
    has_color = vertices.color_names is not None or has_face_colors(header) or is_textured or _is_splats(vertices)
    if not has_color:
        hint = "; if it has a texture image, upload both in one zip" if texture_names(header) else ""
        raise no_color_error(f"{', '.join(names)[:200]}{hint}")
    return vertices
