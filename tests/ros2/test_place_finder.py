"""When the node asks, what it believes of the answers, and what it publishes."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from panoloc.ros2.parameters import Parameters
from panoloc.ros2.poses import Pose, distance_between
from panoloc.ros2.service import NoAnswerError
from tests.ros2.small_world import OPTICAL, STEP_S, TRUTH, World, answer, planar, transform

FLAT = TRUTH.flat
WRONG, OTHER_WRONG = planar(4.0, 0.0, 1.0) @ TRUTH, planar(-5.0, 2.0, 0.0) @ TRUTH


def world(replies: list[Any] | None = None, **parameters: Any) -> World:
    given = Parameters(map="map_a", **parameters)
    return World(given, replies) if replies else World(given)


def off(pose: Pose, truth: Pose = FLAT) -> tuple[float, float]:
    """Return metres and degrees between two."""
    metres, radians = distance_between(pose, truth)
    return metres, math.degrees(radians)


def test_a_robot_that_stands_still_gets_its_first_pose_from_one_frame() -> None:
    robot = world()
    robot.drive(seconds=1)
    assert [len(query.frames) for query in robot.queries] == [1]
    ((_, initial),) = robot.initial
    assert off(initial) == pytest.approx((0, 0), abs=1e-6)
    assert off(robot.map_from_odom) == pytest.approx((0, 0), abs=1e-6)


def test_planar_results_lie_at_height_0_and_others_where_the_floor_of_the_scan_is() -> None:
    tilted = Pose(TRUTH.rotation @ planar(0, 0, 0).rotation, TRUTH.position)
    for is_planar, height in ((True, 0.0), (False, 0.3)):
        robot = world([answer(tilted)], planar=is_planar)
        robot.drive(seconds=1)
        assert robot.map_from_odom.position[2] == pytest.approx(height)
        assert robot.poses[-1][1].position[2] == pytest.approx(height)


def test_a_transform_is_dated_ahead_and_comes_at_a_steady_rate() -> None:
    robot = world(rate_hz=10, tf_tolerance_s=0.3)
    robot.drive(seconds=3)
    stamps = [stamp for stamp, _ in robot.transforms]
    assert np.diff(stamps) == pytest.approx(0.1)
    assert [stamp + 0.3 for stamp, _, _ in robot.poses] == pytest.approx(stamps)
    assert stamps[-1] <= robot.time + 0.3 + 1e-9


def test_without_publish_tf_only_poses_are_published() -> None:
    robot = world(publish_tf=False)
    robot.drive(seconds=2)
    assert not robot.transforms
    assert robot.poses
    assert len(robot.initial) == 1


def test_frames_are_collected_while_the_robot_turns_or_drives_and_the_newest_comes_first() -> None:
    robot = world([answer(TRUTH, status="not_localized", map_from_session=None, warnings=["turn"])])
    robot.drive(turn_deg=105, seconds=3.5)
    assert [len(query.frames) for query in robot.queries] == [1, 2, 3, 4]
    robot.drive(metres=4, seconds=8)
    query = robot.queries[-1]
    assert len(query.frames) == 6
    stamps = [frame.stamp for frame in query.frames]
    assert stamps == sorted(stamps, reverse=True)
    places = [frame.odom_from_camera for frame in query.frames]
    assert all(distance_between(a, b)[0] >= 0.5 for a, b in pairwise(places))
    assert query.expected is None
    assert not robot.transforms
    assert robot.warnings == ["not_localized: turn"]


def test_images_taken_in_a_fast_turn_are_left_out() -> None:
    robot = world()
    robot.drive(seconds=0.2, images=False)
    robot.drive(turn_deg=180, seconds=2)
    # The first is there before the turn is noticed.
    assert sum(len(query.frames) for query in robot.queries) <= 1


def test_a_query_describes_the_camera_where_it_was_at_the_time_of_the_image() -> None:
    robot = world([answer(TRUTH, status="not_localized", map_from_session=None)])
    robot.drive(metres=2, seconds=2)
    frame = robot.queries[-1].frames[0]
    along = (frame.stamp - 100) * 1.0  # a metre a second
    sent = frame.camera["session_from_camera"]["position_m"]
    assert [sent[axis] for axis in "xyz"] == pytest.approx([along + OPTICAL.position[0], 0, 0.9], abs=1e-6)


def test_it_asks_again_by_distance_by_doubt_and_by_time() -> None:
    cases: list[tuple[dict[str, Any], float, float, float]] = [
        ({"distance_m": 2.0, "period_s": 1e3, "max_std_m": 1e3}, 2.6, 0, 6),
        ({"distance_m": 1e3, "period_s": 1e3, "max_std_m": 0.1}, 2.6, 0, 6),
        ({"distance_m": 1e3, "period_s": 10.0, "max_std_m": 1e3}, 0, 0, 11),
    ]
    for parameters, metres, turn, seconds in cases:
        robot = world(**parameters)
        robot.drive(seconds=1)
        assert len(robot.queries) == 1
        robot.drive(metres / 2.6 * 1.0, turn, seconds / 3)
        assert len(robot.queries) == 1, parameters
        robot.drive(metres / 2.6 * 1.6, turn, seconds * 2 / 3 + 1)
        assert len(robot.queries) == 2, parameters


def test_a_query_says_where_the_robot_is_expected() -> None:
    robot = world()
    robot.drive(seconds=1)
    robot.drive(metres=1.6, seconds=4)
    query = robot.queries[-1]
    assert query.expected is not None
    expected, spread = query.expected
    assert off(expected, TRUTH @ query.frames[0].odom_from_camera) == pytest.approx((0, 0), abs=1e-4)
    assert 0.03 < spread.position_m < 0.2
    prior = query.options["hints"]["prior"]
    assert prior["position_std_m"] == spread.position_m
    assert prior["pose"]["map_from_camera"]["position_m"]["x"] == pytest.approx(expected.position[0])


def test_a_wrong_answer_moves_nothing_nor_does_another_wrong_one() -> None:
    robot = world([answer(TRUTH), answer(WRONG), answer(OTHER_WRONG), answer(TRUTH)])
    robot.drive(seconds=1)
    robot.drive(metres=4, seconds=8)
    assert len(robot.queries) >= 4
    assert max(off(each)[0] for _, each in robot.transforms) < 0.01
    assert len(robot.initial) == 1
    assert sum("doubted" in text for text in robot.infos) == 2
    # What decides between the two knows nothing of the estimate, and shares no frame with the first.
    assert robot.queries[2].expected is None
    assert {id(frame) for frame in robot.queries[2].frames}.isdisjoint({id(frame) for frame in robot.queries[1].frames})


def test_the_same_wrong_answer_from_the_same_place_moves_nothing() -> None:
    robot = world([answer(TRUTH), answer(WRONG)], period_s=5.0)
    robot.drive(seconds=40)
    assert len(robot.queries) > 4
    assert max(off(each)[0] for _, each in robot.transforms) < 0.01


def test_a_robot_that_was_carried_away_is_found_by_a_second_answer_that_agrees() -> None:
    robot = world([answer(TRUTH), answer(WRONG)])
    robot.drive(seconds=1)
    robot.drive(metres=1.2, seconds=3)
    assert off(robot.map_from_odom)[0] < 0.01
    robot.drive(turn_deg=60, seconds=3)
    assert off(robot.map_from_odom, WRONG.flat)[0] < 0.05
    assert len(robot.initial) == 2  # AMCL has to know


def test_at_first_an_answer_of_less_confidence_needs_a_second_one_from_elsewhere() -> None:
    robot = world([answer(TRUTH, confidence=0.9)])
    robot.drive(seconds=30)
    assert len(robot.queries) > 2
    assert not robot.poses
    robot.drive(turn_deg=60, seconds=3)
    assert off(robot.map_from_odom) == pytest.approx((0, 0), abs=1e-6)


@pytest.mark.parametrize("status", ["not_localized", "ambiguous"])
def test_an_answer_that_is_not_sure_moves_nothing(status: str) -> None:
    robot = world([answer(TRUTH), answer(WRONG, status=status, warnings=["go on"])])
    robot.drive(seconds=1)
    robot.drive(metres=4, seconds=8)
    assert len(robot.queries) > 2
    assert max(off(each)[0] for _, each in robot.transforms) < 0.01
    assert f"{status}: go on" in robot.warnings


def test_frames_that_contradict_each_other_are_dropped_and_new_ones_asked_about_at_once() -> None:
    robot = world([answer(TRUTH), answer(WRONG, reasons=["images_contradict"]), answer(TRUTH)])
    robot.drive(seconds=1)
    robot.drive(metres=1.2, seconds=3)
    assert len(robot.queries) == 2
    robot.drive(metres=0.6, seconds=2)
    assert [len(query.frames) for query in robot.queries[2:]] == [1]
    assert off(robot.map_from_odom)[0] < 0.01


def test_answers_are_weighed_by_their_radii() -> None:
    """Estimate and answer as normal distributions: the mean weighed by inverse variances, worked out here by hand."""
    beside = planar(0.15, 0.0, 0.0) @ TRUTH
    robot = world([answer(TRUTH, position_m=0.1), answer(beside, position_m=0.2)])
    robot.drive(seconds=1)
    robot.drive(metres=1.2, seconds=3)
    least, way = 0.02, robot.queries[1].frames[0].travel.distance_m - robot.queries[0].frames[0].travel.distance_m
    before = (0.1 / 1.872) ** 2 + least**2
    angle = (math.radians(0.5) / 1.872) ** 2 + math.radians(0.5) ** 2
    before += (0.05 * way) ** 2 + angle * way**2
    after = (0.2 / 1.872) ** 2 + least**2
    moved = off(robot.map_from_odom)[0]
    assert moved == pytest.approx(0.15 * before / (before + after), rel=0.1)


def test_a_correction_turns_the_robot_where_it_is_and_not_about_the_origin_of_odom() -> None:
    base = planar(30.0, 0.0, 0.0)
    robot = world([answer(TRUTH)])
    robot.odom_from_base = base
    robot.drive(seconds=1)
    # The heading is off by a degree, the place is not.
    turned_there = TRUTH @ base @ planar(0, 0, math.radians(1.0)) @ base.inverse()
    robot.replies = [answer(turned_there)]
    robot.drive(metres=1.2, seconds=3)
    found = robot.poses[-1][1]
    assert off(found, FLAT @ robot.odom_from_base)[0] < 0.03
    assert 0.2 < off(found, FLAT @ robot.odom_from_base)[1] < 0.9


def test_the_spread_grows_with_the_way_and_falls_with_an_answer() -> None:
    robot = world(distance_m=3.0, max_std_m=1.0)
    robot.drive(seconds=1)
    first = robot.poses[-1][2].position_m
    robot.drive(metres=2.0, seconds=4)
    grown = robot.poses[-1][2].position_m
    assert grown == pytest.approx(math.hypot(first, 0.05 * 2.0, math.radians(0.5) * 2.0), rel=0.1)
    robot.drive(metres=1.2, seconds=4)
    assert robot.poses[-1][2].position_m < 0.6 * grown
    covariance = robot.poses[-1][2].covariance
    assert len(covariance) == 36
    assert np.diag(np.reshape(covariance, (6, 6)))[0] == pytest.approx(robot.poses[-1][2].position_m ** 2)


def test_a_service_that_is_down_or_busy_is_waited_for_and_that_is_said_once() -> None:
    robot = world([NoAnswerError("waiting for the service", 0.0)] * 5 + [answer(TRUTH)])
    robot.drive(seconds=1)
    assert len(robot.queries) == 6
    assert robot.warnings == ["waiting for the service"]
    assert off(robot.map_from_odom)[0] < 0.01
    robot = world([NoAnswerError("busy", 60.0), answer(TRUTH)])
    robot.drive(turn_deg=90, seconds=5)
    assert len(robot.queries) == 1


def test_odometry_that_starts_anew_and_time_that_goes_back_end_what_was_known() -> None:
    for text in ("odom jumped by 40.0 m", "time went back"):
        robot = world()
        robot.drive(metres=2, seconds=4)
        assert robot.transforms
        robot.transforms.clear()
        robot.replies = [answer(TRUTH, status="not_localized", map_from_session=None)]
        if text.startswith("time"):
            robot.time -= 50
        else:
            robot.odom_from_base = robot.odom_from_base @ planar(40, 0, 0)
        robot.drive(seconds=1)
        assert [each for each in robot.warnings if each.startswith(text)] == [f"{text}: localizing anew"]
        assert not robot.transforms
        robot.replies = [answer(TRUTH)]
        robot.drive(turn_deg=60, seconds=2)
        assert robot.transforms


def test_what_is_missing_is_said() -> None:
    robot = world(camera_frame="elsewhere")
    robot.drive(seconds=3)
    assert robot.warnings[0].startswith("no tf from 'odom' to 'elsewhere'")
    robot = world()
    robot.finder.on_camera_info(None)
    robot.drive(seconds=1)
    robot.finder.say_what_is_missing()
    (said,) = robot.warnings
    assert said.startswith("nothing came yet: camera_info;")


def test_a_transform_that_is_none_is_passed_over() -> None:
    robot = world()
    for broken in (0.0, math.nan):
        message = transform(robot.time, "odom", "base_link", planar(0, 0, 0))
        turn = message.transforms[0].transform.rotation
        turn.x = turn.y = turn.z = turn.w = broken
        robot.finder.on_tf(message)
    robot.drive(seconds=1)
    assert robot.transforms


def test_odometry_that_comes_unevenly_does_not_halve_the_rate() -> None:
    robot = world(rate_hz=20)
    robot.drive(seconds=1)
    stamps, rng = [], np.random.default_rng(0)
    for number in range(200):
        stamp = robot.time + 0.05 * (number + 1) + float(rng.uniform(-0.01, 0.01))
        robot.finder.on_tf(transform(stamp, "odom", "base_link", planar(0, 0, 0)))
        stamps.append(stamp)
    after = [stamp for stamp, _, _ in robot.poses if stamp > stamps[0]]
    assert len(after) > 180


@pytest.mark.parametrize(
    "given",
    [
        {"map": ""},
        {"url": "localhost"},
        {"rate_hz": 0.0},
        {"period_s": -1.0},
        {"max_std_m": math.nan},
        {"min_confidence": 2.0},
    ],
)
def test_parameters_that_cannot_be_meant_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(given))):
        Parameters(**({"map": "map_a"} | given))


def test_a_stale_answer_is_held_against_where_the_robot_is_now() -> None:
    robot = world()
    pending: list[Any] = []
    ask = robot._ask

    def later(query: Any) -> Any:
        done = ask(query)
        pending.append(done)
        waiting: Any = type(done)()
        pending.append(waiting)
        return waiting

    robot.finder._ask = later
    robot.drive(seconds=1)
    robot.drive(metres=3, turn_deg=90, seconds=6)
    done, waiting = pending[:2]
    assert len(robot.queries) == 1
    waiting.set_result(done.result())
    robot.drive(seconds=STEP_S, images=False)
    assert off(robot.poses[-1][1], FLAT @ robot.odom_from_base) == pytest.approx((0, 0), abs=1e-6)
    # What was driven since counts as uncertain.
    assert robot.poses[-1][2].position_m > 0.1


def test_a_moving_mount_is_looked_up_at_the_time_of_the_image() -> None:
    robot = world([answer(TRUTH, status="not_localized", map_from_session=None)])
    finder = robot.finder
    for number in range(60):
        mast = planar(0, 0, 0.02 * number)
        finder.on_tf(transform(99.9 + number * STEP_S, "base_link", "mast", mast))
    finder.on_tf(transform(0, "mast", "optical", OPTICAL), is_static=True)
    robot.drive(seconds=1)
    frame = robot.queries[-1].frames[0]
    turned = (frame.stamp - 99.9) / STEP_S * 0.02
    assert off(frame.odom_from_camera, planar(0, 0, turned) @ OPTICAL) == pytest.approx((0, 0), abs=1e-4)


def test_others_that_publish_the_map_do_not_turn_back_time() -> None:
    robot = world()
    for _ in range(20):
        robot.drive(seconds=0.1)
        for ahead in (3.0, 0.2):
            robot.finder.on_tf(transform(robot.time + ahead, "map", "odom", planar(1, 2, 3)))
    assert not robot.warnings
    assert robot.transforms
