"""The points that two photos, or a panorama, of a painted box are aligned on, against the walls of the box."""

import math

import numpy as np
import pytest
import torch

from panoloc.core.camera.rig import Rig
from panoloc.core.features.equalization import equalize
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.geometry.projection import pixels_towards, project
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.refine.aligned_points import (
    images_showing,
    look_directions,
    points_seen_from_poses,
    points_seen_from_starts,
    views_from_starts,
)
from panoloc.core.refine.step import PointPlanes
from panoloc.core.render.comparison import RigView
from tests.core.built_maps import AS_LABELS, BOX, LABELLED, POSE, map_of, panorama, rig_of, tensors_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import MAP_FROM_SESSION, OF_TWO, TWO, rig_pose

SESSION = OF_TWO
RIG = rig_pose(SESSION)
HEIGHT = 64
PHOTOS = RigPyramid(SESSION, 256, None, "cpu")


def pyramid_of(rig: Rig) -> RigPyramid:
    return RigPyramid(rig, 256, None, "cpu")


def shown_by_photos(directions: torch.Tensor) -> torch.Tensor:
    """Return which directions (N, 3) in the axes of the rig one of the two pinholes shows, parallax aside."""
    shown = torch.zeros(len(directions), dtype=torch.bool)
    for image in SESSION.images:
        camera = image.photo.camera
        x, y, z = (directions @ torch.from_numpy(image.session_from_camera.rotation).float()).T
        shown |= (x > 0) & ((y / x).abs() < camera.cx_px / camera.fx_px) & ((z / x).abs() < camera.cy_px / camera.fy_px)
    return shown


@pytest.mark.parametrize("margin_deg", [0.0, 15.0])
def test_directions_are_spread_over_what_photos_show_and_as_densely_around(margin_deg: float) -> None:
    look = look_directions(PHOTOS, 800, margin_deg, 15.0)
    assert bool((look.patches.diff() >= 0).all())
    assert float((look.inside == shown_by_photos(look.directions)).float().mean()) > 0.97
    everywhere = even_directions(20_000)
    shown = everywhere[shown_by_photos(everywhere)]
    off = torch.rad2deg(torch.acos((look.directions @ shown.T).amax(1).clamp(-1, 1)))
    assert margin_deg - 3.0 < float(off.max()) < margin_deg + 3.0  # told by pixels of 2.8 degrees
    around = torch.rad2deg(torch.acos((everywhere @ shown.T).amax(1).clamp(-1, 1))) < max(margin_deg, 1.0)
    assert len(look.directions) / int(around.sum()) == pytest.approx(800 / len(shown), rel=0.15)


def test_each_point_is_looked_up_in_the_image_whose_middle_is_nearest_to_it() -> None:
    towards = np.random.default_rng(0).normal(size=(200, 3))
    points = BOX.points_along(RIG.position, towards)
    of_angle = []
    for pose, cone in zip(TWO, PHOTOS.cones.tolist(), strict=True):
        camera = MAP_FROM_SESSION.after(pose)
        seen = (points - camera.position) @ camera.rotation
        of_angle.append(np.arccos(seen[:, 0] / np.linalg.norm(seen, axis=1)) / cone)
    found = known(images_showing(PHOTOS, torch.from_numpy(points).float()[None], *tensors_of(RIG)))
    np.testing.assert_array_equal(found[0].numpy(), np.argmin(of_angle, axis=0))
    assert images_showing(pyramid_of(rig_of(panorama())), torch.zeros((1, 5, 3)), *tensors_of(POSE)) is None


# From starts.


def from_starts(
    pyramid: RigPyramid, rotations: torch.Tensor, coarse: bool, contrast_share: float, rows: tuple[int, ...] = (1,)
) -> PointPlanes:
    """Return what candidates at the starts 5 and 9, of which `rows` names one each, should see."""
    starts, numbers = torch.tensor([5, 9]), torch.tensor(rows)
    look, views = look_directions(pyramid, 300, 5.0, 22.5), views_from_starts(map_of(BOX), starts, HEIGHT)
    at = rotations.expand(len(rows), 3, 3), map_of(BOX).starts[starts[numbers]]
    return points_seen_from_starts(pyramid, map_of(BOX).render_cloud, views, numbers, *at, look, coarse, contrast_share)


@pytest.mark.parametrize("query", ["photos", "panorama"])
def test_points_of_a_start_are_those_of_its_view_in_its_colours_equalized(query: str) -> None:
    pyramid, pose = (PHOTOS, RIG) if query == "photos" else (pyramid_of(rig_of(panorama())), POSE)
    rotation, _ = tensors_of(pose)
    found, look = from_starts(pyramid, rotation, False, 0.0), look_directions(pyramid, 300, 5.0, 22.5)
    start = map_of(BOX).starts[9]
    seen = found.weights[0] > 0
    assert float(seen.float().mean()) > 0.3  # of a sparse scan, many pixels show no point
    along = look.directions @ rotation[0].T
    relative = found.positions[0].T[seen] - start
    for here, there in zip(
        project(relative, HEIGHT, 2 * HEIGHT), project(along[seen], HEIGHT, 2 * HEIGHT), strict=True
    ):
        assert torch.equal(here.long(), there.long())
    assert torch.equal(found.sums.patches, look.patches)
    views = views_from_starts(map_of(BOX), torch.tensor([9]), HEIGHT)
    shown = views.full[..., :3][:, pixels_towards(along, HEIGHT)]
    expected = equalize(shown, (seen & look.inside).float()[None])
    torch.testing.assert_close(found.colors[0].T[seen], expected[0][seen])
    assert float((found.colors[0].T - shown[0])[seen].abs().mean()) > 0.05


def test_of_half_the_resolution_points_are_the_same_and_colours_coarser_or_nothing_but_contrast() -> None:
    rotation, _ = tensors_of(RIG)
    fine, half = (from_starts(PHOTOS, rotation, coarse, 0.0) for coarse in (False, True))
    assert torch.equal(fine.positions, half.positions)
    assert torch.equal(fine.weights, half.weights)
    assert 0 < float((fine.colors - half.colors).abs().mean()) < 0.2
    views = views_from_starts(map_of(BOX), torch.tensor([5, 9]), HEIGHT)
    look = look_directions(PHOTOS, 300, 5.0, 22.5)
    pixel = pixels_towards(look.directions @ rotation[0].T, HEIGHT // 2)
    contrast = views.half[1, pixel, 3:]
    torch.testing.assert_close(from_starts(PHOTOS, rotation, True, 1.0).colors[0].T, contrast)


def test_each_candidate_has_the_points_of_its_own_start() -> None:
    rotation, _ = tensors_of(RIG)
    both = from_starts(PHOTOS, rotation, False, 0.5, rows=(1, 0))
    for number, row in enumerate((1, 0)):
        alone = from_starts(PHOTOS, rotation, False, 0.5, rows=(row,))
        torch.testing.assert_close(both.colors[number], alone.colors[0])
        assert torch.equal(both.positions[number], alone.positions[0])
    assert not torch.equal(both.positions[0], both.positions[1])


def test_labels_are_neither_equalized_nor_mixed_with_contrast() -> None:
    index = map_of(LABELLED, AS_LABELS)
    views = views_from_starts(index, torch.tensor([2]), HEIGHT)
    assert views.full.shape[-1] == views.half.shape[-1] == 3
    assert index.labels is not None
    pyramid = RigPyramid(rig_of(LABELLED.panorama(POSE)), 128, index.labels, "cpu")
    look = look_directions(pyramid, 300, 0.0, 22.5)
    at = torch.eye(3)[None], index.starts[2:3]
    found = points_seen_from_starts(pyramid, index.render_cloud, views, torch.tensor([0]), *at, look, False, 0.8)
    pixel = pixels_towards(look.directions, HEIGHT)
    torch.testing.assert_close(found.colors[0].T, views.full[0, pixel])


# From poses.


@pytest.mark.parametrize("query", ["photos", "panorama"])
@pytest.mark.parametrize("share", [0.0, 0.7])
def test_points_of_a_pose_have_the_colours_that_were_compared_mixed_with_contrast(share: float, query: str) -> None:
    pyramid, pose = (PHOTOS, RIG) if query == "photos" else (pyramid_of(rig_of(panorama())), POSE)
    rotations, positions = at = tensors_of(pose)
    view, look = RigView(pyramid, 8.0), look_directions(pyramid, 300, 0.0, 15.0)
    compared = view.compare(map_of(BOX).render_cloud, *at, HEIGHT)
    found = points_seen_from_poses(view, map_of(BOX).render_cloud, compared, *at, look, share)
    assert torch.equal(found.sums.patches, look.patches)
    seen = found.weights[0] > 0
    assert set(found.weights[0].tolist()) == {0.0, 1.0}
    towards = torch.nn.functional.normalize(found.positions[0].T[seen] - positions, dim=-1) @ rotations[0]
    off = torch.acos((towards * look.directions[seen]).sum(-1).clamp(-1, 1))
    assert float(off.max()) < 2 * math.pi / HEIGHT  # each point lies where the rig looks
    window, views = compared.views.window, compared.views
    pixel, _ = window.pixels_towards(look.directions[seen] @ view.rig_from_view)
    shown = (compared.weights > 0).view(views.valid.shape)
    inside = shown.flatten(1)[0, pixel]
    assert float(inside.float().mean()) > 0.7
    # At their edges both sides know equally little; beyond them only the scan knows anything.
    for which, known_pixels in ((inside, shown), (~inside, views.valid)):
        contrast = local_contrast(views.color, known_pixels.float(), window).flatten(1, 2)[0, pixel]
        expected = torch.lerp(compared.scan[0, pixel], contrast, share)
        torch.testing.assert_close(found.colors[0].T[seen][which], expected[which])
