"""`panoloc export` of what `panoloc localize --out` has kept."""

import json
from pathlib import Path
from typing import Any

from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import READY_MAP, FakeService, answer_with

EXIT_ERROR, EXIT_USAGE, EXIT_UNREACHABLE = 1, 2, 5


def test_answers_are_exported_with_those_that_have_no_pose_beside(
    panoloc: Panoloc, fake: FakeService, photos: Path, tmp_path: Path
) -> None:
    fake.answers = {"rooms/b.png": answer_with("not_localized")}
    (photos / "rooms" / "hall.jpg").write_bytes((photos / "rooms" / "a.jpg").read_bytes())
    images = [photos / name for name in ("hall.jpg", "rooms/hall.jpg", "rooms/b.png")]
    out = tmp_path / "answers"
    panoloc("localize", *images, "--map", "map_1", "--out", out)
    outcome = panoloc("export", out, "--export", "potree,colmap")
    assert outcome.code == 0, outcome.err
    rows = [line.split("\t") for line in (out / "potree" / "coordinates.txt").read_text().splitlines()[1:]]
    assert [(row[0], float(row[2]), float(row[3])) for row in rows] == [
        ("hall.jpg", 1.25, 0.5),
        ("hall-2.jpg", 1.25, 0.5),
    ]
    assert (out / "potree" / "unplaced.txt").read_text().startswith("b.png\tnot_localized: ")
    assert " 40 50 60 " in (out / "colmap" / "points3D.txt").read_text()
    # One of them alone, in a place on Earth that its map has by now; beside it where nothing else is said.
    place = {"latitude_deg": 47.7, "longitude_deg": -122.3, "height_m": 11.5, "heading_deg": 0.0}
    fake.polls = [{**READY_MAP, "georeference": place}]
    assert panoloc("export", out / "hall.json", "--export", "geojson").code == 0
    assert len(json.loads((out / "geojson" / "photos.geojson").read_text())["features"]) == 1


def test_each_frame_of_a_session_is_exported_with_its_own_pose(
    panoloc: Panoloc, fake: FakeService, photos: Path, tmp_path: Path
) -> None:
    answer: dict[str, Any] = answer_with("localized")
    moved = json.loads(json.dumps(answer["pose"]))
    moved["map_from_camera"]["position_m"]["x"] = 9.5
    camera = {"model": "pinhole", "hfov_deg": 69.0}
    images = [{"pose": pose, "agreement": 0.8, "camera": camera} for pose in (answer["pose"], moved)]
    files = [str(photos / "hall.jpg"), str(photos / "rooms" / "a.jpg")]
    kept = tmp_path / "capture.json"
    kept.write_text(json.dumps({"files": files, **answer, "images": images}))
    assert panoloc("export", kept, "--export", "tum", "--out", tmp_path / "out").code == 0
    lines = (tmp_path / "out" / "tum" / "poses.tum").read_text().splitlines()
    assert [float(line.split()[1]) for line in lines if not line.startswith("#")] == [1.25, 9.5]


def test_what_is_no_answer_is_told(panoloc: Panoloc, fake: FakeService, photos: Path, tmp_path: Path) -> None:
    out = tmp_path / "answers"
    panoloc("localize", photos / "hall.jpg", "--map", "map_1", "--out", out)
    (photos / "hall.jpg").rename(photos / "gone.jpg")
    outcome = panoloc("export", out, "--export", "tum")
    assert (outcome.code, "longer" in outcome.err) == (EXIT_USAGE, True)
    (photos / "gone.jpg").rename(photos / "hall.jpg")
    fake.down = True
    assert panoloc("export", out, "--export", "tum").code == EXIT_UNREACHABLE
    fake.down = False
    (out / "hall.json").write_text("{}")
    outcome = panoloc("export", out, "--export", "tum")
    assert (outcome.code, "none of these" in outcome.said) == (EXIT_USAGE, True)
