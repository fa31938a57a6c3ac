"""Frames of a phone with the poses of its own tracking, localized by a running service: what an AR client gets back."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from core.geometry.pose import Pose, pose_error
from tests.integration.running_service import RunningService
from tests.integration.small_room import OPTIONS, small_room
from tests.integration.tracked_frames import TrackedFrames, tracked_frames

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    running = RunningService(tmp_path_factory.mktemp("frames") / "data")
    try:
        running.wait_until_ready()
        yield running
    finally:
        running.stop()


@pytest.fixture(scope="module")
def answer(service: RunningService) -> dict[str, Any]:
    """Return the answer to the four frames."""
    map_id = service.register(small_room().scan, OPTIONS)
    reply = service.localize(tracked_frames().images, map_id, tracked_frames().options)
    assert reply.status_code == 200, reply.text
    return dict(reply.json())


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


def test_every_image_says_what_it_was_taken_for(answer: dict[str, Any]) -> None:
    for image in answer["images"]:
        assert image["camera"]["model"] == "pinhole"
        assert image["camera"]["hfov_deg"] == pytest.approx(100, abs=0.1)
