"""What the properties are drawn from."""

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

Array = NDArray[np.float64]


def finite(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def _normalized(values: list[float]) -> Array:
    quaternion = np.array(values)
    length = np.linalg.norm(quaternion)
    return np.array([0.0, 0.0, 0.0, 1.0]) if length < 1e-3 else quaternion / length


def matrix_of(quaternion: Array) -> Array:
    """Return the rotation matrix of (x, y, z, w) as the map v ↦ q v q*, written with the cross product."""
    axis, w = quaternion[:3], quaternion[3]
    columns = [v + 2 * np.cross(axis, np.cross(axis, v) + w * v) for v in np.eye(3)]
    return np.stack(columns, axis=1)


quaternions = st.lists(finite(-1, 1), min_size=4, max_size=4).map(_normalized)
rotations = quaternions.map(matrix_of)
vectors = st.tuples(finite(-50, 50), finite(-50, 50), finite(-50, 50)).map(np.array)
