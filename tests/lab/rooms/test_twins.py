"""Rooms that are alike: what is seen in one is seen in the others, exactly, mirrored, or but for a thing or two."""

from functools import cache

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import Scene, SceneSpec, View, build_scene, sample_pose, scan_scene, take_view
from panoloc.lab.rooms.scenes.generator import SceneKind
from panoloc.lab.rooms.scenes.twin_scene import twin_poses


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
    for view in (first, second):  # surfaces face inwards in both
        facing = (scene.surface.normals[view.hits.triangle] * view.directions).sum(1)[view.hits.found]
        assert (facing < 0).mean() > 0.97
    # The light is mirrored too.
    lit, mirrored = (take_view(scene, one, 128).panorama.color.astype(int) for one in (pose, other))
    assert np.median(np.abs(lit - mirrored[:, ::-1])) <= 3


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "num_rooms"), [("twins", 2), ("repeated", 4)])
def test_rooms_that_are_copies_show_the_same_picture(kind: SceneKind, num_rooms: int) -> None:
    scene, pose = built(kind)
    first, *rest = views(scene, pose, *twin_poses(scene, pose))
    assert (len(rest), len(scene.rooms)) == (num_rooms // 2, num_rooms)
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
