"""`panoloc demo`: its room and its comparison with the truth."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.camera.lens import project_to_image
from panoloc.core.camera.rig import Photo
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.reader import read_image
from panoloc.core.scan.reading import read_scan
from panoloc.lab import demo_room
from panoloc.lab.demo_room import DemoQuery, DemoScene, make_demo_scene
from panoloc.service.host.demo_room import _MAKER, DEMO_FILES
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, answer_with


@contextmanager
def small_files() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("NUM_SCAN_POINTS", 20_000), ("PANORAMA_WIDTH", 128), ("_PHOTO_SIZE", (480, 360))):
            patch.setattr(demo_room, name, value)
        yield


def make(folder: Path) -> DemoScene:
    """Make the room of the demo with small files."""
    with small_files():
        return make_demo_scene(folder, 3, lambda text: None)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> DemoScene:
    return make(tmp_path_factory.mktemp("demo"))


@pytest.fixture
def small_scene(monkeypatch: pytest.MonkeyPatch, scan: Path, panorama: Path) -> DemoScene:
    """Replace the generator by two files; the known pose is 0.3 m and 90 degrees from what the fake answers."""
    quarter_turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    query = DemoQuery(panorama, "as scanned", Pose(quarter_turn, np.array([1.25, 0.5, 1.2])))
    scene = DemoScene(scan, (query, query))

    def make(folder: Path, seed: int, say: Callable[[str], None]) -> DemoScene:
        return scene

    monkeypatch.setattr(demo_room, "make_demo_scene", make)
    return scene


def test_the_demo_prints_the_error_against_the_known_pose_and_keeps_the_pictures(
    panoloc: Panoloc, small_scene: DemoScene, tmp_path: Path
) -> None:
    done = panoloc("demo", "--folder", tmp_path / "demo")
    assert done.code == 0, done.err
    assert done.out.count("off by 30.0 cm and 90.00 degrees") == 2
    assert "http://127.0.0.1:8000/localizations/loc_1/score-map-2d.png" in done.out
    assert (tmp_path / "demo" / "answers" / "photo.score-map-2d.png").read_bytes() == b"a picture"
    assert "panoloc localize" in done.err


def test_a_panorama_that_is_not_found_is_a_failure_and_a_photo_is_sent_as_it_is_known_and_may_fail(
    panoloc: Panoloc, fake: FakeService, small_scene: DemoScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake.status = "not_localized"
    done = panoloc("demo", "--folder", tmp_path / "demo")
    assert done.code == 3
    assert "off by" not in done.out
    told = {"cameras": [{"model": "pinhole", "hfov_deg": 69.0}]}
    photo = DemoScene(small_scene.scan, (replace(small_scene.queries[0], options=told, may_stay_open=True),))
    monkeypatch.setattr(demo_room, "make_demo_scene", lambda folder, seed, say: photo)
    done = panoloc("demo", "--folder", tmp_path / "demo", "--json")
    assert (done.code, done.documents[0]["error_to_truth"]["position_m"]) == (0, None)
    assert json.loads(fake.parts["options"][0])["cameras"] == told["cameras"]


def test_a_service_elsewhere_is_never_started(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    fake.down = True
    done = panoloc("demo", "--folder", tmp_path / "demo", "--url", "http://example.org:8000")
    assert done.code == 1
    assert "only one on this machine can be started" in done.err


@pytest.mark.slow
def test_what_the_service_runs_makes_the_scan_and_the_panorama_of_its_console(
    tmp_path: Path,
) -> None:
    with small_files():
        demo_room.make_demo_room(tmp_path)
    assert demo_room.__name__ == _MAKER
    assert {path.name for path in tmp_path.iterdir()} == set(DEMO_FILES)
    assert len(read_scan(tmp_path / "room.ply")) == 20_000
    assert read_image((tmp_path / "panorama.jpg").read_bytes()).color.shape == (64, 128, 3)


@pytest.mark.slow
def test_the_room_is_the_same_for_the_same_seed_and_its_truth_is_written(made: DemoScene, tmp_path: Path) -> None:
    again = make(tmp_path)
    assert made.scan.read_bytes() == again.scan.read_bytes()
    first, second = (scene.queries[1] for scene in (made, again))
    assert first.image.read_bytes() == second.image.read_bytes()
    truth = json.loads(made.scan.with_name("truth.json").read_text())
    assert truth["queries"][1]["position_m"] == first.pose.position.tolist()
    # A truth.json is of panoramas.
    assert [entry["image"] for entry in truth["queries"]] == ["as-scanned.jpg", "changed.jpg"]
    perfect = answer_with("localized")
    perfect["pose"]["map_from_camera"]["matrix"] = first.pose.matrix.tolist()
    assert first.error_of(perfect) == pytest.approx((0.0, 0.0), abs=1e-5)


@pytest.mark.slow
def test_the_photo_is_of_the_camera_that_the_service_is_told_of(made: DemoScene) -> None:
    photo = made.queries[2]
    image = read_image(photo.image.read_bytes(), camera=CameraDescription(**photo.options["cameras"][0]))
    assert isinstance(image, Photo)
    # What the scan has in front of the camera is in the photo, in its colours.
    cloud = read_scan(made.scan)
    u, v, shown = project_to_image(image.camera, (cloud.positions - photo.pose.position) @ photo.pose.rotation)
    height, width = image.valid.shape
    seen = image.color[v[shown].astype(int).clip(0, height - 1), u[shown].astype(int).clip(0, width - 1)]
    difference = np.abs(seen.astype(int) - cloud.colors[shown]).mean(1)
    assert np.median(difference) < 12
    assert abs(photo.pose.yaw_pitch_roll[1]) < np.radians(5.01)
    assert abs(photo.pose.yaw_pitch_roll[2]) < np.radians(5.01)


def test_without_open3d_the_demo_says_what_is_missing_before_it_starts_anything(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    done = panoloc("demo", "--folder", tmp_path / "demo")
    assert done.code == 1
    assert "expected Open3D" in done.err
    assert "scripts/install" in done.err
    assert fake.requests == []
    assert not (tmp_path / "demo").exists()


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
