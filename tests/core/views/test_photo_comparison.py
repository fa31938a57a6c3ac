"""The scan beside the photos of a session whose cameras stood 0.4 m apart."""

import numpy as np
import pytest
import torch

from core.config import JudgeConfig
from core.geometry.pose import Pose
from core.geometry.projection import pixel_directions
from core.index.map_index import MapIndex
from core.judge.agreement import agreement, agreement_by_photo
from core.panorama.photo_atlas import PhotoAtlas
from core.panorama.session import Session, SessionImage, session_from_rig
from core.views.comparison import Comparison
from core.views.photo_comparison import compare_photos, view_cones
from core.views.synthetic_view import render_views
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import SIDEWAYS, TWO, UPRIGHT, session_of

HEIGHT = 128
CAMERAS = (UPRIGHT, SIDEWAYS)
MAP_FROM_SESSION = Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2]))
MAP_FROM_RIG = Pose(
    MAP_FROM_SESSION.rotation,
    MAP_FROM_SESSION.after(Pose(np.eye(3), np.mean([p.position for p in TWO], axis=0))).position,
)


@pytest.fixture(scope="module")
def session(box: PaintedBox) -> Session:
    return session_of(box, MAP_FROM_SESSION, TWO, CAMERAS)


def compared(session: Session, index: MapIndex, pose: Pose = MAP_FROM_RIG) -> Comparison:
    atlas = PhotoAtlas(session, 512, None, "cpu")
    return compare_photos(index.render_cloud, atlas, *tensors_of(pose), HEIGHT, is_labels=False)


def tensors_of(pose: Pose) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.from_numpy(pose.rotation).float()[None], torch.from_numpy(pose.position).float()[None]


def test_the_cameras_stand_well_apart_and_inside_of_the_box(session: Session, box: PaintedBox) -> None:
    places = np.stack([MAP_FROM_SESSION.after(pose).position for pose in TWO])
    assert ((places > 0.5) & (places < np.array(box.size_m) - 0.5)).all()
    assert np.linalg.norm(places[0] - places[1]) > 0.4
    np.testing.assert_allclose(MAP_FROM_SESSION.after(session_from_rig(session)).position, MAP_FROM_RIG.position)


def test_at_the_true_pose_scan_and_photos_show_the_same_in_spite_of_parallax(
    session: Session, box_index: MapIndex
) -> None:
    right = agreement(compared(session, box_index), HEIGHT, JudgeConfig())
    assert float(right.correlation) > 0.95
    # Cameras that stood where they did not: parallax counts.
    wrong = Session(
        tuple(
            SessionImage(image.photo, Pose(image.session_from_camera.rotation, TWO[0].position))
            for image in session.images
        )
    )
    assert float(agreement(compared(wrong, box_index), HEIGHT, JudgeConfig()).correlation) < 0.85


def test_each_pixel_is_compared_with_the_photo_whose_middle_is_nearest(
    session: Session, box_index: MapIndex, box: PaintedBox
) -> None:
    found = compared(session, box_index)
    assert found.photo is not None
    directions = pixel_directions(HEIGHT, 2 * HEIGHT).reshape(-1, 3).double().numpy()
    size = np.array(box.size_m)
    with np.errstate(divide="ignore"):
        steps = (np.where(directions > 0, size, 0.0) - MAP_FROM_RIG.position) / directions
    points = MAP_FROM_RIG.position + directions * np.where(directions == 0, np.inf, steps).min(axis=1)[:, None]
    best, expected = np.full(len(points), -np.inf), np.full(len(points), -1)
    for number, (camera, pose) in enumerate(zip(CAMERAS, TWO, strict=True)):
        map_from_camera = MAP_FROM_SESSION.after(pose)
        x, y, z = ((points - map_from_camera.position) @ map_from_camera.rotation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            shown = (
                (x > 0) & (np.abs(y / x) < camera.cx_px / camera.fx_px) & (np.abs(z / x) < camera.cy_px / camera.fy_px)
            )
        ahead = x / np.sqrt(x * x + y * y + z * z)
        better = shown & (ahead > best)
        best[better], expected[better] = ahead[better], number
    numbers = found.photo[0].numpy()
    assert set(np.unique(expected)) == {-1, 0, 1}
    assert (numbers == expected).mean() > 0.985  # the rest lies at edges
    for number in (0, 1):
        assert (numbers[expected == number] == number).mean() > 0.9
    assert bool((found.weights[0][found.photo[0] < 0] == 0).all())


def test_agreement_is_told_for_each_photo(session: Session, box_index: MapIndex) -> None:
    both = agreement_by_photo(compared(session, box_index), 2)
    assert all(each is not None and each > 0.9 for each in both)
    first, second = session.images
    spoilt = Session((first, SessionImage(second.photo, Pose(rotation_of(200.0), second.session_from_camera.position))))
    good, bad = agreement_by_photo(compared(spoilt, box_index), 2)
    assert good is not None
    assert bad is not None
    assert bad < 0.5 < 0.8 < good


def test_agreement_is_not_told_of_a_photo_that_shows_nothing_of_the_scan(session: Session, box_index: MapIndex) -> None:
    found = compared(session, box_index)
    assert agreement_by_photo(found, 3)[2] is None
    assert agreement_by_photo(None, 2) == [None, None]


def test_what_the_cones_leave_out_changes_nothing_that_photos_show(session: Session, box_index: MapIndex) -> None:
    atlas = PhotoAtlas(session, 512, None, "cpu")
    rotations, positions = tensors_of(MAP_FROM_RIG)
    cones = view_cones(atlas, rotations)
    width = 2 * HEIGHT
    all_of_it = render_views(box_index.render_cloud, positions, HEIGHT, width)
    part = render_views(box_index.render_cloud, positions, HEIGHT, width, cones=cones)
    towards = pixel_directions(HEIGHT, width) @ cones.axes[0].T
    inside = (towards >= torch.cos(cones.half_angles)).any(-1)
    assert 0.1 < float(inside.float().mean()) < 0.9
    assert torch.equal(part.valid[0] & inside, all_of_it.valid[0] & inside)
    torch.testing.assert_close(part.depth[0][inside], all_of_it.depth[0][inside])
    torch.testing.assert_close(part.color[0][inside], all_of_it.color[0][inside])
    assert float(part.valid.float().mean()) < float(all_of_it.valid.float().mean())
