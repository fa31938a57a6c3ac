"""PTX files as laser scanners' programs write them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def station_text(
    points: Array, colors: NDArray[np.uint8] | None, rotation: Array, translation: Array, num_rows: int = 1
) -> str:
    """Return a station at a pose (x_file = R x + t) that sees `points` (N, 3) of the file's frame; N a multiple of `num_rows`.

    colors: (N, 3), or None. A point that is NaN is a cell without a return.
    """
    local = (points - translation) @ rotation
    rows: list[list[Any]] = [[len(points) // num_rows], [num_rows], translation.tolist(), *rotation.T.tolist()]
    rows += [[*axis, 0] for axis in rotation.T.tolist()] + [[*translation.tolist(), 1]]
    for number, point in enumerate(local.tolist()):
        is_missing = point[0] != point[0]
        color = [] if colors is None else [0, 0, 0] if is_missing else colors[number].tolist()
        rows.append(["0", "0", "0", "0.5", *color] if is_missing else [*point, 0.25, *color])
    return "".join(" ".join(f"{v:.9f}" if isinstance(v, float) else str(v) for v in row) + "\n" for row in rows)
