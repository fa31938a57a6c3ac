"""Change cells of one answer: small enough to keep for weeks, coarse enough that several answers agree."""

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.config import ChangeConfig
from panoloc.core.index.map_index import MapIndex
from panoloc.core.results import Localization

_CELL_M = 0.15
_MOST_CELLS_ACROSS = 30_000  # int16
_MOST_POINTS = 60_000
_LEAST_POINTS = 3  # of a cell, for a meaningful mean


def change_cells(
    index: MapIndex, localization: Localization, config: ChangeConfig | None = None
) -> dict[str, Any] | None:
    """Return the cells in view, and those of them that changed; None for an answer that is not `localized`.

    `cell_m`: edge in metres. `seen`, `changed`: cells as (n, 3) int16, in units of `cell_m` from the map's origin
    without its offset; little-endian, deflated, base64. `changed` is a subset of `seen`.
    """
    scores = localization.point_scores
    if scores is None or localization.status != "localized":
        return None
    known = np.flatnonzero(~np.isnan(scores))
    # Every k-th point is an even sample of the scan: enough for cells, in a tenth of the time.
    known = known[:: max(1, len(known) // _MOST_POINTS)]
    positions = index.positions.cpu().numpy()[known]
    cell_m = max(_CELL_M, float(np.abs(positions).max(initial=0.0)) / _MOST_CELLS_ACROSS)
    places = np.floor(positions / cell_m).astype(np.int64)
    keys, first, of_point = np.unique(
        (places[:, 0] << 34) + (places[:, 1] << 17) + places[:, 2], return_index=True, return_inverse=True
    )
    counts = np.bincount(of_point, minlength=len(keys))
    means = np.bincount(of_point, scores[known], len(keys)) / np.maximum(counts, 1)
    cells = places[first].astype(np.int16)
    enough = counts >= _LEAST_POINTS
    changed = enough & (means < (config or ChangeConfig()).changed_below)
    return {"cell_m": cell_m, "seen": _packed(cells[enough]), "changed": _packed(cells[changed])}


def _packed(cells: NDArray[np.int16]) -> str:
    return base64.b64encode(zlib.compress(cells.astype("<i2").tobytes())).decode("ascii")
