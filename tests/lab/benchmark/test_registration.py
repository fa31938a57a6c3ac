"""A registration in a process of its own."""

from pathlib import Path

import pytest

from lab.benchmark.method.registration import RegistrationFailedError, memory_bytes, register_in_new_process
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.scan_file import write_room_scan


@pytest.mark.slow
def test_the_figures_come_back_from_the_process(tmp_path: Path) -> None:
    write_room_scan(tmp_path / "room.ply", PaintedRoom(0), 3_000)
    found = register_in_new_process(tmp_path / "room.ply", 2.0, 1)
    assert (found.points, found.scan_bytes) == (3_000, (tmp_path / "room.ply").stat().st_size)
    assert found.seconds["total"] > found.seconds["reading"] > 0
    assert found.peak_bytes is None or found.peak_bytes > (found.base_bytes or 0) > 0


@pytest.mark.slow
def test_a_file_that_is_no_scan_ends_with_what_the_process_said(tmp_path: Path) -> None:
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"no scan at all")
    with pytest.raises(RegistrationFailedError, match=r"expected figures, got exit code 1: (.|\n)*Scan\w+Error"):
        register_in_new_process(broken, 0.5, 1)


def test_the_peak_is_never_below_what_is_held_now() -> None:
    found = memory_bytes()
    assert found["peak"] >= found["resident"] > 0
