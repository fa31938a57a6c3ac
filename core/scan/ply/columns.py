"""Which properties of a PLY element are coordinates and colours, and what type the colours have."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanDamagedError
from panoloc.core.scan.ply.header import PlyElement
from panoloc.core.scan.reading_context import stack_columns

POSITION_NAMES = ("x", "y", "z")
_COLOR_NAMES = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("scalar_red", "scalar_green", "scalar_blue"),
)


def color_names(element: PlyElement) -> tuple[str, str, str] | None:
    """Return the names of the colour properties of `element`, or None when it has none."""
    scalars = {prop.name for prop in element.properties if prop.count_type is None}
    return next((names for names in _COLOR_NAMES if scalars.issuperset(names)), None)


def convert_colors(rows: NDArray[np.void], element: PlyElement, names: tuple[str, str, str]) -> NDArray[Any]:
    """Return the raw colours of `rows`, (n, 3) in a type that tells their range apart (see RawChunk)."""
    declared = {prop.name: prop.type for prop in element.properties}[names[0]]
    num_bytes = int(declared[2])
    if declared[1] == "f" or num_bytes > 2:
        return stack_columns(rows, names, np.float64)
    # Some programs call their colour bytes "char" or "short"; nobody means negative colours.
    unsigned = np.dtype(f"u{num_bytes}")
    stored = rows.dtype[names[0]]
    if stored.kind != "f":
        return stack_columns(rows, names, unsigned)
    values = stack_columns(rows, names, np.float64)
    if not np.array_equal(values, np.clip(np.rint(values), 0, np.iinfo(unsigned).max)):
        raise ScanDamagedError(
            f"The PLY header declares colours as whole numbers of {num_bytes * 8} bits, but the data holds "
            f"values from {np.nanmin(values):g} to {np.nanmax(values):g}. Export the scan again."
        )
    return values.astype(unsigned)
