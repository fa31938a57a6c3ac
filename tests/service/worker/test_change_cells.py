"""Points that an answer saw become cells of space; a cell changed when its points did."""

import base64
import zlib
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization, SearchSummary
from panoloc.service.worker.answers import change_cells

POSITIONS = np.array([[0.05, 0.05, 0.05]] * 4 + [[1.0, -1.0, 0.5]] * 4 + [[2.0, 2.0, 2.0]] * 2, np.float32)
INDEX = cast(MapIndex, SimpleNamespace(positions=torch.from_numpy(POSITIONS)))
SCORES = np.array([0.9, 0.8, np.nan, 1.0, 0.1, 0.2, 0.1, np.nan, 0.0, 0.0], np.float32)
SUMMARY = SearchSummary("fast", 1, 1, 1, 1)
SEEN = Localization("localized", SUMMARY, {}, score_points=lambda: SCORES)


def unpacked(packed: str) -> NDArray[np.int16]:
    """Return the cells (n, 3)."""
    return np.frombuffer(zlib.decompress(base64.b64decode(packed)), "<i2").reshape(-1, 3)


def test_a_cell_changed_when_the_mean_of_its_points_says_so_and_few_points_say_nothing() -> None:
    found = cast(dict[str, Any], change_cells(INDEX, SEEN))
    assert found["cell_m"] == 0.15
    assert unpacked(found["seen"]).tolist() == [[0, 0, 0], [6, -7, 3]]
    assert unpacked(found["changed"]).tolist() == [[6, -7, 3]]


def test_cells_grow_with_the_scan_to_fit_in_16_bits() -> None:
    index = cast(MapIndex, SimpleNamespace(positions=INDEX.positions * 10_000))
    found = cast(dict[str, Any], change_cells(index, SEEN))
    assert found["cell_m"] > 0.15
    assert np.abs(unpacked(found["seen"]).astype(int)).max() <= 30_001


def test_an_answer_that_is_not_localized_has_no_cells() -> None:
    assert change_cells(INDEX, replace(SEEN, status="ambiguous")) is None
    assert change_cells(INDEX, replace(SEEN, score_points=None)) is None
