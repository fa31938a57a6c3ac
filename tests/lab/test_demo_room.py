"""The made-up room that anybody can try has a scan that can be read and a panorama of it."""

from pathlib import Path

import pytest
from PIL import Image

from core.scan.reading import read_scan
from lab import demo_room


@pytest.mark.slow
def test_the_demo_room_is_a_coloured_scan_and_a_full_sphere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_room, "NUM_SCAN_POINTS", 4000)
    monkeypatch.setattr(demo_room, "PANORAMA_WIDTH", 64)
    demo_room.make_demo_room(tmp_path)
    cloud = read_scan(tmp_path / "room.ply")
    assert cloud.num_points_read == 4000
    assert cloud.colors.std() > 10
    with Image.open(tmp_path / "panorama.jpg") as panorama:
        assert panorama.size == (64, 32)
