"""Gaussian splats stored as PLY: their centres as points, with the colour that they have from all sides."""

from collections.abc import Iterator

import numpy as np

from panoloc.core.errors import ScanContentError
from panoloc.core.scan.ply.body import PlyBody
from panoloc.core.scan.ply.columns import POSITION_NAMES
from panoloc.core.scan.ply.header import PlyElement, PlyHeader
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, stack_columns

MIN_OPACITY = 0.5
"""Of a splat on a surface. More transparent ones are haze between surfaces and cameras."""
_COLORS = ("f_dc_0", "f_dc_1", "f_dc_2")
_SH_C0 = 0.28209479177387814  # the constant harmonic, 1 / (2 sqrt(pi))
_PACKED = "packed_position"


def has_splats(header: PlyHeader) -> bool:
    """Tell whether the vertices are Gaussian splats. Raises ScanContentError for splats in a packed form."""
    vertices = header.element("vertex")
    scalars = {prop.name for prop in vertices.properties if prop.count_type is None} if vertices is not None else set()
    if _PACKED in scalars:
        raise ScanContentError(
            "The PLY holds Gaussian splats in a packed form. Export them unpacked, with x y z, f_dc_0 f_dc_1 f_dc_2 and opacity."
        )
    return {*_COLORS, "opacity"} <= scalars


def iter_splats(context: ReadingContext, header: PlyHeader, vertices: PlyElement, body: PlyBody) -> Iterator[RawChunk]:
    """Yield the centres of splats that are opaque enough, colours uint8. Raises ScanContentError when there is none."""
    for element in header.elements:
        if element is vertices:
            break
        body.skip(element)
    num_done, num_kept = 0, 0
    logit = float(np.log(MIN_OPACITY / (1 - MIN_OPACITY)))  # opacities are stored before the logistic function
    for rows in body.iter_scalar_rows(vertices, [*POSITION_NAMES, *_COLORS, "opacity"]):
        num_done += len(rows)
        rows = rows[rows["opacity"] >= logit]
        num_kept += len(rows)
        harmonics = np.nan_to_num(stack_columns(rows, _COLORS, np.float64))
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
