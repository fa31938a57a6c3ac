"""Rooms that are alike: what is seen in one is seen in the others, exactly, mirrored, or but for a thing or two."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scene, SceneSpec, View, build_scene, make_case, sample_pose, scan_scene, take_view
from panoloc.lab.rooms.scenes.generator import SceneKind
from panoloc.lab.rooms.scenes.twin_scene import mirrored_room, twin_poses
from panoloc.lab.rooms.suites import SUITES


@cache
def built(kind: SceneKind) -> tuple[Scene, Pose]:
    """Return a scene of small rooms and a level pose in one of those that are alike."""
    scene, rng = build_scene(SceneSpec(kind, 3, area_m2=10.0)), np.random.default_rng(1)
    poses = (sample_pose(scene, rng, "tilted") for _ in range(100))
    assert scene.twins is not None
    return scene, next(pose for pose in poses if scene.twins.number_at(pose.position) is not None)


def views(scene: Scene, *poses: Pose) -> list[View]:
    return [take_view(scene, pose, 256, "labels") for pose in poses]


def test_a_mirrored_room_shows_the_mirror_image_at_the_mirrored_pose() -> None:
    scene, pose = built("mirrored")
    (other,) = twin_poses(scene, pose)
    assert np.linalg.det(other.rotation) == pytest.approx(1)
    first, second = views(scene, pose, other)
    assert (first.panorama.color == second.panorama.color[:, ::-1]).all(-1).mean() > 0.98
    assert (first.panorama.color == second.panorama.color).all(-1).mean() < 0.9
    np.testing.assert_allclose(twin_poses(scene, other)[0].matrix, pose.matrix, atol=1e-12)


def test_the_surfaces_of_a_mirrored_room_face_inwards_as_those_of_the_first() -> None:
    scene, pose = built("mirrored")
    for view in views(scene, pose, *twin_poses(scene, pose)):
        facing = (scene.surface.normals[view.hits.triangle] * view.directions).sum(1)[view.hits.found]
        assert (facing < 0).mean() > 0.97


def test_openings_of_a_mirrored_room_are_where_the_mirror_shows_them() -> None:
    room = build_scene(SceneSpec("room", 4, area_m2=14.0)).rooms[0]
    mirrored = mirrored_room(room, 10.0)
    for hole, image in zip(room.openings, mirrored.openings, strict=True):
        (start, along, _), (mirrored_start, mirrored_along, _) = (
            room.wall_frame(hole.wall),
            mirrored.wall_frame(image.wall),
        )
        ends = start + np.array([[hole.start_m], [hole.start_m + hole.width_m]]) * along
        found = mirrored_start + np.array([[image.start_m + image.width_m], [image.start_m]]) * mirrored_along
        np.testing.assert_allclose(found, ends * (-1, 1, 1) + (20.0, 0, 0), atol=1e-9)


@pytest.mark.slow
def test_the_light_of_a_mirrored_room_is_mirrored_too() -> None:
    scene, pose = built("mirrored")
    first, second = (take_view(scene, one, 128).panorama.color for one in (pose, *twin_poses(scene, pose)))
    assert np.median(np.abs(first.astype(int) - second[:, ::-1])) <= 3


@pytest.mark.slow
def test_three_rooms_along_a_corridor_show_the_same_picture() -> None:
    scene, pose = built("repeated")
    others = twin_poses(scene, pose)
    assert len(others) == 2
    assert len(scene.rooms) == 4
    first, *rest = views(scene, pose, *others)
    for other in rest:
        assert (first.panorama.color == other.panorama.color).all(-1).mean() > 0.99


@pytest.mark.slow
def test_the_corridor_is_scanned_and_is_no_twin() -> None:
    scene, _ = built("repeated")
    corridor = scene.rooms[3]
    middle = np.array([(corridor.x0 + corridor.x1) / 2, (corridor.y0 + corridor.y1) / 2, 1.5])
    assert scene.twins is not None
    assert scene.twins.number_at(middle) is None
    assert twin_poses(scene, Pose(np.eye(3), middle)) == ()
    points = scan_scene(scene, num_points=5000).positions
    assert ((points[:, 1] >= corridor.y0 - 0.2) & (points[:, 1] <= corridor.y1 + 0.1)).mean() > 0.05


@pytest.mark.slow
def test_nearly_equal_rooms_differ_in_a_little() -> None:
    scene, pose = built("twins_like")
    (other,) = twin_poses(scene, pose)
    first, second = (take_view(scene, one, 256).panorama.color.astype(int) for one in (pose, other))
    differs = (np.abs(first - second).max(-1) > 30).mean()
    assert 0.0005 < differs < 0.25


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "alternatives", "lookalikes"), [("repeated", 2, 0), ("mirrored", 0, 1), ("twins_like", 0, 1)]
)
def test_cases_know_what_is_as_right_and_what_only_looks_so(name: str, alternatives: int, lookalikes: int) -> None:
    case = make_case(name, replace(SUITES[name], num_points=3000), 2, width=64)
    assert (len(case.alternatives), len(case.lookalikes)) == (alternatives, lookalikes)


@pytest.mark.slow
def test_rooms_that_changed_since_the_scan_are_no_longer_as_right_as_each_other() -> None:
    case = make_case("twins", replace(SUITES["twins"], num_points=3000, change=0.6), 2, width=64)
    assert case.alternatives == ()
    assert len(case.lookalikes) == 1
