"""The scan beside the images of a rig whose cameras stood 0.4 m apart, and beside panoramas."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from panoloc.core.camera.rig import Rig
from panoloc.core.config import JudgeConfig
from panoloc.core.decide.agreement import agreement
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.geometry.sphere_window import SphereWindow, directions_of
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.render.comparison import Comparison, RigView
from panoloc.core.render.render_cloud import ViewParts
from panoloc.core.render.synthetic_view import render_views
from tests.core.built_maps import BOX, POSE, map_of, panorama, rig_of, tensors_of
from tests.core.image.painted_photos import MAP_FROM_SESSION, OF_TWO, SIDEWAYS, TWO, UPRIGHT, rig_pose

HEIGHT = 128
CAMERAS = (UPRIGHT, SIDEWAYS)
SESSION = OF_TWO
RIG = rig_pose(SESSION)


def view_of(rig: Rig = SESSION) -> RigView:
    return RigView(RigPyramid(rig, 512, None, "cpu"), 8.0)


def compared(rig: Rig = SESSION, pose: Pose = RIG) -> Comparison:
    return view_of(rig).compare(map_of(BOX).render_cloud, *tensors_of(pose), HEIGHT)


def correlation(found: Comparison) -> float:
    return float(agreement(found, JudgeConfig(), 1.0, 11.25).correlation)


def test_at_the_true_pose_scan_and_photos_show_the_same_in_spite_of_parallax() -> None:
    assert correlation(compared()) > 0.95
    # Cameras that stood where they did not: parallax counts.
    places = (Pose(pose.rotation, TWO[0].position) for pose in TWO)
    images = (replace(image, session_from_camera=pose) for image, pose in zip(SESSION.images, places, strict=True))
    assert correlation(compared(Rig(tuple(images)))) < 0.85


def test_with_the_focal_length_of_the_pose_photos_of_another_camera_show_what_they_did() -> None:
    wrong, log = SESSION.with_focal_factor(1 / 1.3), torch.tensor([1.3]).log()
    at = map_of(BOX).render_cloud, *tensors_of(RIG), HEIGHT
    assert correlation(view_of(wrong).compare(*at)) < 0.7
    assert correlation(view_of(wrong).compare(*at, log_focals=log)) > 0.95
    twice = at[1].expand(2, 3, 3), at[2].expand(2, 3), HEIGHT
    both = view_of(wrong).compare(at[0], *twice, log_focals=torch.cat((log, 0 * log)))
    agreed = agreement(both, JudgeConfig(), 1.0, 11.25).correlation
    assert float(agreed[0]) > 0.95 > 0.7 > float(agreed[1])


def test_a_panorama_is_compared_in_every_direction() -> None:
    found = compared(rig_of(panorama()), POSE)
    assert found.views.window.is_whole
    assert torch.equal(found.image, torch.where(found.views.valid.flatten(1), 0, -1))
    assert correlation(found) > 0.95
    beside = Pose(POSE.rotation, POSE.position + np.array([0.3, -0.2, 0.0]))
    assert correlation(compared(rig_of(panorama()), beside)) < 0.85


def test_each_pixel_is_compared_with_the_photo_whose_middle_is_nearest() -> None:
    found = compared()
    directions = directions_of(found.views.window, torch.device("cpu")) @ found.views.map_from_view[0].T
    points = BOX.points_along(RIG.position, directions.double().numpy())
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
    numbers = found.image[0].numpy()
    assert set(np.unique(expected)) == {-1, 0, 1}
    assert (numbers == expected).mean() > 0.985  # the rest lies at edges
    for number in (0, 1):
        assert (numbers[expected == number] == number).mean() > 0.9
    assert bool((found.weights[0][found.image[0] < 0] == 0).all())


def test_the_part_that_is_drawn_is_that_of_the_whole_view_and_all_that_photos_show() -> None:
    view, cloud, (_, positions) = view_of(), map_of(BOX).render_cloud, tensors_of(RIG)
    views = compared().views
    num_pixels = views.window.height * views.window.width
    assert 0.1 < num_pixels / (2 * HEIGHT**2) < 0.7
    sphere, axes = SphereWindow.of_sphere(HEIGHT), view.pyramid.rotations[:, :, 0]
    whole = render_views(cloud, positions, ViewParts(views.map_from_view, sphere, axes[None], torch.full((2,), 4.0)))

    def drawn(image: Tensor) -> Tensor:
        """Return the first image on the whole sphere."""
        shape = (HEIGHT, 2 * HEIGHT, *image.shape[3:])
        return views.window.on_sphere(image[:1].flatten(1, 2))[0].view(shape)

    inside = views.window.on_sphere(torch.ones(1, num_pixels))[0] > 0
    inside = inside.view(HEIGHT, 2 * HEIGHT)
    directions = pixel_directions(HEIGHT, 2 * HEIGHT) @ view.rig_from_view.T
    # Parallax of what is a metre away widens what images show.
    half_angles = view.pyramid.cones + torch.asin(view.pyramid.centers.norm(dim=-1))
    near = (directions @ axes.T >= torch.cos(half_angles)).any(-1) & inside
    assert bool(view.pyramid.shows(directions[~inside], math.radians(7.0)).logical_not().all())
    assert torch.equal(drawn(views.valid) & near, whole.valid[0] & near)
    torch.testing.assert_close(drawn(views.depth)[near], whole.depth[0][near])
    torch.testing.assert_close(drawn(views.color)[near], whole.color[0][near])
    assert not bool(drawn(views.valid)[~inside].any())


def test_depth_is_the_median_distance_to_what_is_compared() -> None:
    depth = torch.tensor([[[1.0, 2.0, 5.0], [4.0, 90.0, 90.0]]])
    views: Any = SimpleNamespace(depth=depth)
    colors, weights, image = torch.zeros(1, 6, 3), torch.tensor([[1.0, 0.5, 1, 1e-9, 0, 0]]), torch.zeros(1, 6).long()
    assert Comparison(colors, colors, weights, None, views, image).depth_m == 2.0  # torch takes the lower one of two
    assert Comparison(colors, colors, 0 * weights, None, views, image).depth_m is None
