"""Maps of a run: built once for scans that are the same, and no more of them kept than are needed."""

from typing import Any

import numpy as np
import pytest

from core.options import IndexOptions
from core.scan.point_cloud import PointCloud
from lab.evaluation.built_maps import BuiltMaps
from lab.evaluation.known_cases import LoadedScan


def scan(seed: int, method: Any = "octree", color: int = 0) -> LoadedScan:
    positions = np.random.default_rng(seed).random((5, 3)).astype(np.float32)
    cloud = PointCloud(positions, np.full((5, 3), color, np.uint8))
    return LoadedScan(cloud, IndexOptions(method), lambda _: pytest.fail("no query is asked for"))


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[PointCloud]:
    """Return the clouds that maps were built of."""
    clouds: list[PointCloud] = []

    def build(cloud: PointCloud, *_: object, **__: object) -> object:
        clouds.append(cloud)
        return object()

    monkeypatch.setattr("lab.evaluation.built_maps.build_map_index", build)
    return clouds


def test_scans_of_the_same_points_have_one_map(built: list[PointCloud]) -> None:
    maps = BuiltMaps("cpu", 2)
    assert maps.of(scan(1)) == maps.of(scan(1))
    assert len(built) == 1


@pytest.mark.parametrize("other", [scan(2), scan(1, "grid"), scan(1, color=9)], ids=["points", "options", "colours"])
def test_others_have_their_own(built: list[PointCloud], other: LoadedScan) -> None:
    maps = BuiltMaps("cpu", 2)
    assert maps.of(scan(1))[0] is not maps.of(other)[0]
    assert len(built) == 2


def test_the_map_that_was_not_asked_for_the_longest_is_let_go(built: list[PointCloud]) -> None:
    maps = BuiltMaps("cpu", 2)
    for number in (1, 2, 1, 3, 1):
        maps.of(scan(number))
    assert len(built) == 3
    maps.of(scan(2))
    assert len(built) == 4
