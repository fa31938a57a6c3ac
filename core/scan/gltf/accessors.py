"""Arrays of numbers in a glTF file."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import CUT_SHORT, ScanContentError, ScanDamagedError
from core.scan.gltf.container import GltfFile

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_accessor(file: GltfFile, number: Any, what: str) -> NDArray[Any]:
    """Return an accessor as (n, width) in the type that is stored, whole numbers that stand for fractions as float64.

    Raises ScanDamagedError when it does not fit its bytes, ScanContentError for a form that is not read.
    """
    accessor = file.document["accessors"][file_index(number)]
    component, width = _TYPES.get(accessor["componentType"]), _WIDTHS.get(accessor["type"])
    count = accessor["count"]
    if component is None or width is None or not isinstance(count, int) or count < 0:
        raise ScanDamagedError(f"The {what} of the glTF file have an unknown type or count. Export the scan again.")
    if "sparse" in accessor or "bufferView" not in accessor:
        raise ScanContentError(
            f"The {what} of the glTF file are stored sparsely, which is not read. Export the scan as plain GLB."
        )
    data, stride = file.view(accessor["bufferView"])
    dtype = np.dtype(component)
    offset, stride = file_index(accessor.get("byteOffset", 0)), stride or width * dtype.itemsize
    needed = offset + stride * (count - 1) + width * dtype.itemsize if count else 0
    if needed > len(data) or stride < width * dtype.itemsize:
        raise ScanDamagedError(
            f"The glTF file announces {count:,} {what} in {needed:,} bytes, but there are {len(data):,}. {CUT_SHORT}"
        )
    values = np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))
    if accessor.get("normalized") and dtype.kind in "iu":
        return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
    return values


def file_index(number: Any) -> int:
    """Return a number of an entry or byte. Raises ScanDamagedError for what is none."""
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise ScanDamagedError(f"The glTF file refers to entry {str(number)[:40]}. Export the scan again.")
    return number
