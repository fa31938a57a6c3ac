"""Folders of photos with known poses: what is copied, and whose pose it has."""

import json
from pathlib import Path

import numpy as np
import pytest

from core.scan.reading import read_scan
from lab.placing import known_photos as module
from lab.placing.killed_run import error_of
from lab.placing.known_photos import known_photos
from tests.core.exports.tours import GOLDEN, jpeg


def case_of(folder: Path, num_photos: int) -> Path:
    folder.mkdir()
    queries = []
    for number in range(num_photos):
        (folder / f"{number}.jpg").write_bytes(jpeg())
        position = (GOLDEN.position + number).tolist()
        queries.append({"image": f"{number}.jpg", "rotation": GOLDEN.rotation.tolist(), "position_m": position})
    (folder / "truth.json").write_text(json.dumps({"scans": ["a.ply", "b.ply"], "queries": queries}))
    return folder


def test_photos_of_several_cases_have_folders_of_their_own_and_their_poses(tmp_path: Path) -> None:
    cases = [case_of(tmp_path / name, 3) for name in ("house", "shed")]
    known = known_photos(tmp_path / "work", cases, [], 0, limit=2)
    assert [photo.name for photo in known.photos] == ["house/0.jpg", "house/1.jpg", "shed/0.jpg", "shed/1.jpg"]
    assert sorted(path.relative_to(known.folder).as_posix() for path in known.folder.rglob("*.jpg")) == [
        photo.name for photo in known.photos
    ]
    assert known.scans == {name: tmp_path / name / "a.ply" for name in ("house", "shed")}
    np.testing.assert_array_equal(known.photos[3].pose.position, GOLDEN.position + 1)


def test_an_answer_in_the_map_of_another_place_is_wrong_however_near(tmp_path: Path) -> None:
    (photo,) = known_photos(tmp_path / "work", [case_of(tmp_path / "house", 1)], [], 0).photos
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = GOLDEN.rotation, GOLDEN.position
    answer = {"status": "localized", "map_id": "map_1", "pose": {"map_from_camera": {"matrix": matrix.tolist()}}}
    assert error_of(photo, {"house": "map_1"}, answer) == pytest.approx((0, 0), abs=1e-5)
    assert error_of(photo, {"house": "map_2"}, answer) == (np.inf, np.inf)
    assert error_of(photo, {"house": "map_1"}, {"status": "ambiguous"}) is None


@pytest.mark.slow
def test_a_flat_is_scanned_and_photographed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FLAT_POINTS", 2_000)
    monkeypatch.setattr(module, "_FLAT_PANORAMA_WIDTH", 64)
    known = known_photos(tmp_path, [], [1000], 1)
    assert [photo.name for photo in known.photos] == ["flat-1000/00.jpg"]
    lower, upper = read_scan(known.scans["flat-1000"]).bounds
    assert (lower < known.photos[0].pose.position).all()
    assert (known.photos[0].pose.position < upper).all()
