"""Scenes are repeatable, varied, and leave room for a camera."""

import numpy as np
import pytest

from panoloc.core.errors import OptionsError
from panoloc.lab.rooms import FAMILIES, Scene, SceneSpec, build_scene, sample_pose, scan_scene, take_panorama
from panoloc.lab.rooms.capture.free_space import random_rotation


@pytest.mark.slow
def test_the_same_specification_gives_the_same_scan_and_panorama() -> None:
    clouds, images = [], []
    for _ in range(2):
        scene = build_scene(SceneSpec("room", 7, area_m2=10.0))
        clouds.append(scan_scene(scene, num_points=5000, seed=3))
        images.append(take_panorama(scene, sample_pose(scene, np.random.default_rng(1)), 128).color)
    np.testing.assert_array_equal(clouds[0].positions, clouds[1].positions)
    np.testing.assert_array_equal(clouds[0].colors, clouds[1].colors)
    np.testing.assert_array_equal(images[0], images[1])


@pytest.mark.slow
def test_flats_have_four_to_six_rooms_joined_by_open_doorways(flat: Scene) -> None:
    assert 4 <= len(flat.rooms) <= 6
    joined = list(range(len(flat.rooms)))
    for number, room in enumerate(flat.rooms):
        for hole in room.openings:
            if hole.kind != "passage":
                continue
            start, along, inward = room.wall_frame(hole.wall)
            middle = start + (hole.start_m + hole.width_m / 2) * along + [0, 0, 1.6]
            beyond = middle - 0.3 * inward
            assert not flat.surface.blocked((middle + 0.05 * inward)[None], beyond[None])[0]
            other = [n for n, r in enumerate(flat.rooms) if r.x0 < beyond[0] < r.x1 and r.y0 < beyond[1] < r.y1]
            assert other
            joined = [joined[number] if group == joined[other[0]] else group for group in joined]
    assert len(set(joined)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["room", "bare", "flat"])
def test_rooms_have_no_holes_to_the_outside(kind: str) -> None:
    scene = build_scene(SceneSpec(kind, 6))  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for _ in range(4):
        hits = scene.surface.cast(sample_pose(scene, rng).position, directions)
        assert hits.found.all()
        # Nobody looks at the back of a wall either: surfaces are seen from outside their solids.
        from_behind = (scene.surface.normals[hits.triangle] * directions).sum(1) > 1e-3
        assert from_behind.mean() < 0.01


@pytest.mark.slow
def test_rooms_are_small_and_large_furnished_in_every_family_and_nearly_empty_where_bare() -> None:
    def movable(spec: SceneSpec) -> int:
        return sum(thing.item is not None and thing.movable for thing in build_scene(spec).objects)

    areas = [np.prod(build_scene(SceneSpec("room", seed)).rooms[0].size_m) for seed in range(7)]
    assert 8 <= min(areas) < 16
    assert 35 < max(areas) <= 60
    furnished = [movable(SceneSpec("room", 3, family=family)) for family in FAMILIES]
    assert min(furnished) >= 5
    assert np.mean([movable(SceneSpec("bare", seed)) for seed in range(6)]) < 0.5 * np.mean(furnished)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["room", "flat", "street"])
def test_cameras_stand_in_free_space_at_eye_height(kind: str) -> None:
    scene = build_scene(SceneSpec(kind, 5))  # type: ignore[arg-type]
    rng = np.random.default_rng(2)
    positions = np.array([sample_pose(scene, rng).position for _ in range(5)])
    assert (scene.surface.clearance(positions) > 0.39).all()
    assert ((positions[:, 2] >= 1.0) & (positions[:, 2] <= 1.9)).all()


def test_rotations_are_of_the_kind_asked_for() -> None:
    rng = np.random.default_rng(0)
    anything = np.array([random_rotation(rng, "any") for _ in range(300)])
    np.testing.assert_allclose(
        anything @ anything.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (300, 3, 3)), atol=1e-12
    )
    assert np.linalg.det(anything).min() > 0.999
    assert np.abs(anything.mean(0)).max() < 0.15
    tilted = np.array([random_rotation(rng, "tilted") for _ in range(100)])
    assert np.degrees(np.arccos(tilted[:, 2, 2])).max() <= 15.0
    assert np.degrees(np.arccos(tilted[:, 2, 2])).max() > 10.0
    upright = random_rotation(rng, "upright")
    np.testing.assert_allclose(upright[2], (0, 0, 1), atol=1e-12)


def test_unknown_names_are_refused_with_what_is_known() -> None:
    with pytest.raises(OptionsError, match="room, flat, bare, street"):
        build_scene(SceneSpec("castle"))  # type: ignore[arg-type]
    with pytest.raises(OptionsError, match="nordic"):
        build_scene(SceneSpec(family="baroque"))
