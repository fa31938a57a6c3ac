"""Changes between scan and photo, and the truth about them."""

import numpy as np
import pytest

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms import (
    Scan,
    Scene,
    SceneSpec,
    View,
    build_scene,
    change_scene,
    changed_pixels,
    changed_points,
    sample_pose,
    take_view,
)
from panoloc.lab.rooms.capture.intruders import add_person
from panoloc.lab.rooms.materials.labels import label_number


def test_an_unchanged_scene_has_no_changed_pixels_or_points(room: Scene, room_view: View, room_scan: Scan) -> None:
    assert not changed_pixels(room_view, room, room).any()
    assert not changed_points(room_scan, room, room).any()


@pytest.mark.slow
def test_rugs_are_gone_and_the_floor_below_counts_as_changed() -> None:
    seed = next(s for s in range(50) if any("/rug@" in key for key in build_scene(SceneSpec("room", s)).keys))
    scene = build_scene(SceneSpec("room", seed))
    bare = change_scene(scene, 0.0)
    gone = set(scene.keys) - set(bare.keys)
    assert gone
    assert all("/rug@" in key for key in gone)
    rug = next(thing for thing in scene.objects if thing.key in gone)
    area = rug.footprint
    assert area is not None
    pose = sample_pose(bare, np.random.default_rng(0), "upright")
    view = take_view(bare, pose, 256)
    points = pose.position + view.directions * view.hits.distance[:, None]
    on_floor = bare.surface.label[view.hits.triangle] == label_number("floor")
    changed = changed_pixels(view, bare, scene).ravel()
    x, y, _ = points.T
    inside = (x > area.x0 + 0.02) & (x < area.x1 - 0.02) & (y > area.y0 + 0.02) & (y < area.y1 - 0.02)
    assert changed[inside & on_floor].all()
    assert (inside & on_floor).any()


def test_changed_pixels_are_where_the_distance_or_the_object_differs(
    room: Scene, changed_room: Scene, pose: Pose
) -> None:
    now, before = take_view(changed_room, pose, 256), take_view(room, pose, 256)
    truth = changed_pixels(now, changed_room, room).ravel()
    assert 0.02 < truth.mean() < 0.9
    same_distance = np.abs(now.hits.distance - before.hits.distance) < 1e-4
    names = np.array(changed_room.keys)[changed_room.surface.object_index[now.hits.triangle]]
    names_before = np.array(room.keys)[room.surface.object_index[before.hits.triangle]]
    # Where the old scene shows the very same point of the same thing, nothing changed, save for the strips of wall that
    # show through the finger-wide gap behind furniture.
    assert truth[same_distance & (names == names_before)].mean() < 0.002
    fixtures = ("ceiling_lamp", "radiator", "socket", "switch")
    assert {t.key for t in room.objects if not t.item or t.item.name in fixtures} <= set(changed_room.keys)
    new_things = set(changed_room.keys) - set(room.keys)
    assert truth[np.isin(names, list(new_things))].all()


def test_points_of_removed_things_are_changed_and_those_of_walls_are_not(
    room: Scene, changed_room: Scene, room_scan: Scan
) -> None:
    truth = changed_points(room_scan, room, changed_room)
    names = np.array(room.keys)[room.surface.object_index[room_scan.hits.triangle]]
    gone = set(room.keys) - set(changed_room.keys)
    assert truth[np.isin(names, list(gone))].all()
    assert truth[names == "room0/ceiling"].mean() < 0.05
    assert 0.02 < truth.mean() < 0.8


@pytest.mark.slow
def test_about_the_asked_fraction_of_the_furniture_changes() -> None:
    changed, total = np.zeros(2), 0
    fractions = (0.3, 0.6)
    for seed in range(7):
        scene = build_scene(SceneSpec("room", seed))
        movable = {t.key for t in scene.objects if t.item and t.movable and t.item.anchor != "floor"}
        changed += [len(movable - set(change_scene(scene, fraction, seed).keys)) for fraction in fractions]
        total += len(movable)
    assert np.abs(changed / total - fractions).max() < 0.12


@pytest.mark.slow
def test_doors_of_a_flat_swing_around_their_hinges(flat: Scene) -> None:
    now = change_scene(flat, 1.0, seed=1)
    before = {thing.key: thing for thing in flat.objects if thing.hinge}
    after = {thing.key.split("~")[0]: thing for thing in now.objects if thing.hinge}
    assert before
    for key, leaf in before.items():
        reach = []
        for thing in (leaf, after[key]):
            assert thing.hinge is not None
            corners = np.concatenate([part.vertices for part in thing.pieces[0].parts])
            reach.append(np.hypot(*(corners[:, :2] - thing.hinge).T).max())
        assert abs(reach[0] - reach[1]) < 1e-9
        assert after[key].key != key


@pytest.mark.slow
def test_a_street_changes_its_cars_but_not_its_houses() -> None:
    scene = build_scene(SceneSpec("street", 1))
    now = change_scene(scene, 0.6, 1)
    gone, new = set(scene.keys) - set(now.keys), set(now.keys) - set(scene.keys)
    assert gone
    assert new
    assert not any(key.startswith(("house", "road", "pavement", "garden")) for key in gone | new)
    assert not any("sofa" in key for key in new)


def test_a_person_stands_near_the_camera_and_counts_as_changed(room: Scene) -> None:
    pose = sample_pose(room, np.random.default_rng(3), "upright")
    with_person = add_person(room, pose, seed=2)
    assert len(with_person.objects) == len(room.objects) + 1
    view = take_view(with_person, pose, 256)
    person = with_person.surface.label[view.hits.triangle] == label_number("person")
    assert person.sum() > 50
    assert changed_pixels(view, with_person, room).ravel()[person].all()
    assert 0.3 < view.hits.distance[person].min() < 2.4
