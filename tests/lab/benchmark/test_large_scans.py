"""Scans that are written piece by piece hold what the room shows."""

from pathlib import Path

import numpy as np
import pytest

from core.options import ScanOptions
from core.scan.reading import read_scan
from lab.benchmark.method import large_scans
from lab.benchmark.painted_room import PaintedRoom


@pytest.mark.slow
@pytest.mark.parametrize("kind", large_scans.WRITERS)
def test_a_scan_of_several_pieces_and_stations_is_that_of_the_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(large_scans, "_POINTS_PER_STATION", 2_000)
    monkeypatch.setattr(large_scans, "_WRITTEN_AT_ONCE", 1_500)
    room, path = PaintedRoom(0), tmp_path / f"scan.{kind}"
    large_scans.WRITERS[kind](path, room, 5_000)
    cloud = read_scan(path, ScanOptions(max_points_used=10_000))
    expected = room.scan(5_000)
    assert cloud.num_points_read == 5_000
    for bound, true_bound in zip(cloud.bounds, expected.bounds, strict=True):
        np.testing.assert_allclose(bound, true_bound, atol=0.05)
    np.testing.assert_allclose(cloud.colors.mean(axis=0), expected.colors.mean(axis=0), atol=4)
