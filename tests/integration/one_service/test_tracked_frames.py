"""Frames of a phone that is turned around in the small room, tracked as ARKit, ARCore and WebXR do: what an AR client gets back."""

import io
import json
import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.lab.rooms import take_panorama
from tests.core.image.picture_files import encoded
from tests.core.painted_box import rotation_of
from tests.integration.running_service import RunningService
from tests.integration.small_room import room_scene, small_room

pytestmark = pytest.mark.integration


_WIDTH, _HEIGHT, _HFOV_DEG = 480, 360, 100.0
_ARM_M = 0.1
PICTURES = ["score_map_2d", "score_map_3d", "overlay"]


@dataclass(frozen=True)
class TrackedFrames:
    """images: JPEG. session_from_camera: webxr poses (4, 4), y up. map_from_session: the truth (4, 4), both sides y up."""

    images: list[bytes]
    session_from_camera: list[NDArray[np.float64]]
    map_from_session: NDArray[np.float64]

    @property
    def options(self) -> str:
        """Return the options of the query."""
        focal_px = _WIDTH / 2 / math.tan(math.radians(_HFOV_DEG) / 2)
        lens = {"model": "pinhole", "width_px": _WIDTH, "height_px": _HEIGHT, "fx_px": focal_px}
        cameras = [{**lens, "session_from_camera": _as_sent(pose)} for pose in self.session_from_camera]
        asked = {"frame": "webxr", "cameras": cameras, "session": {"up": "known"}, "artifacts": PICTURES}
        return json.dumps(asked)


@cache
def tracked_frames() -> TrackedFrames:
    """Take four frames at right angles, each a little away from the middle."""
    middle, images, poses = small_room().pose.position, [], []
    # Where the device began to track: turned by 40 degrees about the vertical, somewhere in the room.
    map_from_session = _y_up(Pose(rotation_of(40.0), middle + np.array([0.4, -0.2, -1.1])))
    for number in range(4):
        turn = rotation_of(25.0 + 90 * number)
        pose = Pose(turn, middle + _ARM_M * turn[:, 0])
        images.append(_photo(pose))
        poses.append(np.linalg.inv(map_from_session) @ pose.in_frame("webxr").matrix)
    return TrackedFrames(images, poses, map_from_session)


def _photo(pose: Pose) -> bytes:
    """Return what a pinhole at `pose` takes: pixels of a panorama along its rays."""
    panorama = take_panorama(room_scene(), pose, 1024)
    column, row = np.meshgrid(np.arange(_WIDTH) + 0.5, np.arange(_HEIGHT) + 0.5)
    focal_px = _WIDTH / 2 / math.tan(math.radians(_HFOV_DEG) / 2)
    left, up = (_WIDTH / 2 - column) / focal_px, (_HEIGHT / 2 - row) / focal_px
    c = (math.pi - np.arctan2(left, 1.0)) / (2 * math.pi) * 1024
    r = (math.pi / 2 - np.arctan2(up, np.hypot(left, 1.0))) / math.pi * 512
    return encoded(panorama.color[r.astype(int), c.astype(int)], "JPEG", quality=92)


def _y_up(between_worlds: Pose) -> NDArray[np.float64]:
    """Return a motion between worlds with z up (4, 4) as one between worlds with y up: (x, z, −y)."""
    axes = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    turned: NDArray[np.float64] = axes @ between_worlds.matrix @ axes.T
    return turned


def _as_sent(pose: NDArray[np.float64]) -> dict[str, Any]:
    known = Pose(pose[:3, :3], pose[:3, 3])
    return {
        "position_m": dict(zip("xyz", known.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", known.quaternion_xyzw.tolist(), strict=True)),
    }


@pytest.fixture(scope="module")
def answer(service: RunningService, map_id: str) -> dict[str, Any]:
    """Return the answer to the four frames."""
    reply = service.localize(tracked_frames().images, map_id, tracked_frames().options)
    assert reply.status_code == 200, reply.text
    return dict(reply.json())


def wall() -> bytes:
    """Return a photo of plaster: one colour, a little grain."""
    grain = np.random.default_rng(0).normal(215, 2, (480, 640, 1)).repeat(3, axis=2)
    return encoded(grain.astype(np.uint8))


def screenshot() -> bytes:
    """Return an upright page: white, with lines of text and a bar of buttons."""
    page = np.full((1280, 720, 3), 255, np.uint8)
    for row in range(100, 1100, 30):
        page[row : row + 12, 40 : 300 + row % 370] = 40
    page[1180:, :] = (30, 110, 220)
    return encoded(page)


def motion(found: dict[str, Any]) -> NDArray[np.float64]:
    return np.array(found["matrix"])


def error_between(found: NDArray[np.float64], known: NDArray[np.float64]) -> Any:
    return pose_error(*(Pose(each[:3, :3], each[:3, 3]) for each in (found, known)))


def test_content_that_is_anchored_by_map_from_session_stands_where_it_should(answer: dict[str, Any]) -> None:
    frames: TrackedFrames = tracked_frames()
    assert answer["status"] == "localized", answer
    assert answer["pose"]["frame"] == "webxr"
    assert error_between(motion(answer["map_from_session"]), frames.map_from_session).within(0.05, 3)


def test_the_pose_of_each_image_is_map_from_session_after_its_own(answer: dict[str, Any]) -> None:
    frames = tracked_frames()
    found = [motion(image["pose"]["map_from_camera"]) for image in answer["images"]]
    assert len(found) == len(frames.images)
    for pose, session_from_camera in zip(found, frames.session_from_camera, strict=True):
        # The service may take a little of the tracking's noise out.
        assert error_between(pose, motion(answer["map_from_session"]) @ session_from_camera).within(0.02, 1)
        assert error_between(pose, frames.map_from_session @ session_from_camera).within(0.05, 3)
    np.testing.assert_allclose(motion(answer["pose"]["map_from_camera"]), found[0], atol=1e-6)

    for image in answer["images"]:
        assert image["camera"]["model"] == "pinhole"
        assert image["camera"]["hfov_deg"] == pytest.approx(100, abs=0.1)


def test_the_next_query_of_the_session_names_the_answer_and_is_looked_for_where_its_poses_put_it(
    service: RunningService, map_id: str, answer: dict[str, Any]
) -> None:
    frames = tracked_frames()
    turned = [frames.images[number] for number in (2, 3, 0, 1)]
    asked = json.loads(frames.options)
    asked["cameras"] = [asked["cameras"][number] for number in (2, 3, 0, 1)]
    then, now = (motion(answer["images"][number]["pose"]["map_from_camera"]) for number in (0, 2))
    since = np.linalg.inv(then) @ now
    for prior in (
        {"localization_id": answer["id"]},
        {"localization_id": answer["id"], "motion": _as_sent(since)},
    ):
        reply = service.localize(turned, map_id, json.dumps({**asked, "hints": {"prior": prior}}))
        assert reply.status_code == 200, reply.text
        found = reply.json()
        assert (found["status"], found["search"]["num_starts"]) == ("localized", 0)  # nothing was searched
        assert error_between(motion(found["map_from_session"]), frames.map_from_session).within(0.05, 3)


def test_frames_that_contradict_each_other_are_an_answer_and_never_a_sure_one(
    service: RunningService, map_id: str
) -> None:
    frames = tracked_frames()
    shuffled = [frames.images[number] for number in (2, 0, 3, 1)]
    for images in (shuffled, frames.images[:1] * 4):
        reply = service.localize(images, map_id, frames.options)
        assert reply.status_code == 200, reply.text
        assert reply.json()["status"] != "localized"
        assert len(reply.json()["images"]) == 4


@pytest.mark.parametrize("image", [wall(), screenshot()], ids=["a wall", "a screenshot"])
def test_a_picture_that_shows_nothing_of_the_place_is_not_localized(
    service: RunningService, map_id: str, image: bytes
) -> None:
    unknown = service.localize(image, map_id)
    assert unknown.status_code == 422
    assert "options.cameras" in unknown.json()["detail"]
    reply = service.localize(image, map_id, json.dumps({"cameras": [{"model": "pinhole", "hfov_deg": 69}]}))
    assert reply.status_code == 200, reply.text
    assert reply.json()["status"] != "localized"
    assert reply.json()["map_from_session"] is None


def test_the_pictures_of_a_session_are_drawn(service: RunningService, answer: dict[str, Any]) -> None:
    pictures = {name: fetched(service, path) for name, path in answer["artifacts"].items()}
    assert {name: each.shape[1] for name, each in pictures.items()} == dict.fromkeys(PICTURES, 1024)
    upper, lower = np.split(pictures["overlay"], [512])
    shown = (upper != upper[0, 0]).any(axis=2)  # the zenith is in no image
    # The images stand above the scan as it looks from there: what both show has the same colours.
    assert np.corrcoef(upper[shown].ravel(), lower[4:][shown].ravel())[0, 1] > 0.7
    # Nothing has changed since the scan, so what the images show is green, and what they do not show has no tint.
    red, green, _ = pictures["score_map_2d"][shown].mean(axis=0)
    assert green > red + 10
    assert np.ptp(pictures["score_map_2d"][~shown].mean(axis=0)) < 15


def fetched(service: RunningService, path: str) -> NDArray[np.float64]:
    """Return a picture of an answer (h, w, 3)."""
    return np.asarray(Image.open(io.BytesIO(service.http.get(path).content)).convert("RGB"), np.float64)
