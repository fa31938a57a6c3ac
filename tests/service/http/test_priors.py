"""Priors by an earlier answer: where the camera is expected, and what is no answer to go by."""

import json
from typing import Any

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose, matrix_from_quaternion
from panoloc.core.options import Frame, PosePrior
from tests.core.painted_box import rotation_of
from tests.service.http.fake_pool import POSE, outcome_of
from tests.service.http.running_service import RunningService

pytestmark = pytest.mark.anyio

MOVED = Pose(rotation_of(30.0, 10.0, -5.0), np.array([2.0, -0.4, 0.1]))
"""The pose of the camera now in the axes of the camera then: x forward, y left, z up."""
FRAMES: list[Frame] = ["ros", "opencv", "webxr", "unity"]


def as_sent(matrix: np.ndarray) -> dict[str, Any]:
    pose = Pose(matrix[:3, :3], matrix[:3, 3])
    return {
        "position_m": dict(zip("xyz", pose.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", pose.quaternion_xyzw.tolist(), strict=True)),
    }


def tracked(pose: Pose, frame: Frame) -> list[dict[str, Any]]:
    return [{"model": "equirectangular", "session_from_camera": as_sent(pose.in_frame(frame).matrix)}]


async def prior_of(running: RunningService, map_id: str, prior: dict[str, Any], **options: Any) -> PosePrior:
    """Return the prior that a worker gets."""
    reply = await running.localize(map_id, options=json.dumps({"hints": {"prior": prior}, **options}))
    assert reply.status_code == 200, reply.text
    hints = running.pool.jobs[-1].options.hints
    assert hints is not None
    assert hints.prior is not None
    return hints.prior


async def first_answer(running: RunningService, map_id: str, **options: Any) -> Any:
    return (await running.localize(map_id, options=json.dumps(options))).json()


def pose_of(prior: PosePrior) -> Pose:
    return Pose.from_frame(prior.position_m, prior.quaternion_xyzw, prior.frame)


@pytest.mark.parametrize("frame", FRAMES)
async def test_the_camera_is_expected_where_its_motion_since_an_answer_took_it(
    running: RunningService, frame: Frame
) -> None:
    map_id = await running.ready_map()
    answer = await first_answer(running, map_id, frame=frame)
    # What a client computes of two poses of its own tracking: inverse(world_from_then) · world_from_now, in its own axes.
    then, now = POSE.in_frame(frame).matrix, POSE.after(MOVED).in_frame(frame).matrix
    motion = as_sent(np.linalg.inv(then) @ now)
    found = await prior_of(running, map_id, {"localization_id": answer["id"], "motion": motion}, frame=frame)
    np.testing.assert_allclose(pose_of(found).matrix, POSE.after(MOVED).matrix, atol=1e-9)
    way_m = np.linalg.norm(MOVED.position)
    assert found.position_std_m == pytest.approx(answer["accuracy"]["position_m"] + 0.01 * way_m)
    assert found.orientation_std_deg == pytest.approx(answer["accuracy"]["orientation_deg"] + 0.1 * way_m)


async def test_deviations_that_are_given_stay(running: RunningService) -> None:
    map_id = await running.ready_map()
    given = {"position_std_m": 2.0, "orientation_std_deg": 30.0}
    answer = await first_answer(running, map_id)
    motion = as_sent(MOVED.matrix)
    found = await prior_of(running, map_id, {"localization_id": answer["id"], "motion": motion, **given})
    assert (found.position_std_m, found.orientation_std_deg) == (2.0, 30.0)


@pytest.mark.parametrize("frame", ["ros", "webxr", "unity"])
async def test_in_one_tracked_session_the_poses_of_both_queries_say_the_motion(
    running: RunningService, frame: Frame
) -> None:
    map_id = await running.ready_map()
    session_from_then = Pose(rotation_of(-70.0), np.array([5.0, 1.0, -2.0]))
    answer = await first_answer(running, map_id, frame=frame, cameras=tracked(session_from_then, frame))
    now = tracked(session_from_then.after(MOVED), frame)
    found = await prior_of(running, map_id, {"localization_id": answer["id"]}, frame=frame, cameras=now)
    np.testing.assert_allclose(pose_of(found).matrix, POSE.after(MOVED).matrix, atol=1e-9)
    assert found.position_std_m < 0.05


async def test_without_a_motion_the_camera_is_expected_where_it_was(running: RunningService) -> None:
    map_id = await running.ready_map()
    answer = await first_answer(running, map_id)
    # The answer was to a panorama without a pose, so that nothing ties the session to it.
    for options in ({}, {"cameras": tracked(MOVED, "ros")}):
        found = await prior_of(running, map_id, {"localization_id": answer["id"]}, **options)
        np.testing.assert_allclose(pose_of(found).matrix, POSE.matrix, atol=1e-9)
        assert (found.position_std_m, found.orientation_std_deg) == (0.3, 5.0)


async def test_what_is_no_answer_to_go_by_is_refused_with_what_to_do(running: RunningService) -> None:
    maps = [await running.ready_map() for _ in "12"]
    answer = await first_answer(running, maps[0])
    running.pool.localize = lambda job: _not_localized(job)  # type: ignore[method-assign]
    unsure = await first_answer(running, maps[0])
    assert unsure["status"] == "ambiguous"
    at = {"localization_id": answer["id"]}
    for prior, map_id, more, status, said in (
        ({"localization_id": "loc_none"}, maps[0], {}, 404, "unknown or older than"),
        ({"localization_id": unsure["id"]}, maps[0], {}, 422, "expected a localized answer, got one that is ambiguous"),
        (at, maps[1], {}, 422, f"got one in {maps[0]}"),
        (at, maps[0], {"frame": "webxr"}, 422, "send the same frame"),
        ({}, maps[0], {}, 422, "expected either pose or localization_id, got neither"),
        ({**at, "pose": answer["pose"]}, maps[0], {}, 422, "got both"),
        ({"pose": answer["pose"], "motion": as_sent(MOVED.matrix)}, maps[0], {}, 422, "together with localization_id"),
        ({**at, "motion": {"position_m": {"x": 1, "y": 0, "z": 0}}}, maps[0], {}, 422, "hints.prior.motion.quaternion"),
    ):
        reply = await running.localize(map_id, options=json.dumps({"hints": {"prior": prior}, **more}))
        assert (reply.status_code, said in reply.json()["detail"]) == (status, True), reply.text


async def _not_localized(job: Any) -> Any:
    return outcome_of(job, status="ambiguous")


async def test_the_fetched_answer_says_nothing_of_what_is_stored_for_priors(running: RunningService) -> None:
    map_id = await running.ready_map()
    answer = await first_answer(running, map_id)
    assert await running.json(f"/localizations/{answer['id']}") == answer


def test_a_left_handed_quaternion_has_the_matrix_of_its_own_axes() -> None:
    """What `unity` sends is composed in its own axes: its quaternions make matrices there as others do."""
    pose = MOVED.in_frame("unity")
    np.testing.assert_allclose(matrix_from_quaternion(pose.quaternion_xyzw), pose.rotation, atol=1e-12)
