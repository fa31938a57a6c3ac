"""The points that two photos of a painted box show, against the walls of the box."""

import math

import numpy as np
import pytest
import torch

from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.geometry.projection import pixels_towards, project
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.refine.photo_points import (
    look_directions,
    photos_showing,
    points_seen_by_photos,
    points_seen_in_starts,
    views_from_starts,
)
from panoloc.core.render.photo_comparison import RigView
from tests.core.built_maps import BOX, map_of, tensors_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import MAP_FROM_SESSION, TWO, rig_pose, session_of

SESSION = session_of(TWO)
RIG = rig_pose(SESSION)
POSE = tensors_of(RIG)
HEIGHT = 64
ATLAS = PhotoAtlas(SESSION, 256, None, "cpu")


def test_each_point_is_looked_up_in_the_photo_whose_middle_is_nearest_to_it() -> None:
    towards = np.random.default_rng(0).normal(size=(200, 3))
    points = BOX.points_along(RIG.position, towards)
    of_angle = []
    for pose, cone in zip(TWO, ATLAS.cones.tolist(), strict=True):
        camera = MAP_FROM_SESSION.after(pose)
        seen = (points - camera.position) @ camera.rotation
        of_angle.append(np.arccos(seen[:, 0] / np.linalg.norm(seen, axis=1)) / cone)
    found = known(photos_showing(ATLAS, torch.from_numpy(points).float()[None], *POSE))
    np.testing.assert_array_equal(found[0].numpy(), np.argmin(of_angle, axis=0))


def test_points_of_a_start_are_those_of_its_view_in_its_colours() -> None:
    starts, rows = torch.tensor([5, 9]), torch.tensor([1])
    look = look_directions(ATLAS, 300, 5.0)
    views = views_from_starts(map_of(BOX), starts, HEIGHT)
    found = points_seen_in_starts(
        ATLAS, map_of(BOX).render_cloud, views, rows, POSE[0], map_of(BOX).starts[starts[rows]], look, False, None
    )
    seen = found.weights[0] > 0
    assert float(seen.float().mean()) > 0.3
    relative = found.positions[0][seen] - map_of(BOX).starts[starts[1]]
    along = look.directions[seen] @ POSE[0][0].T
    for here, there in zip(project(relative, HEIGHT, 2 * HEIGHT), project(along, HEIGHT, 2 * HEIGHT), strict=True):
        assert torch.equal(here.long(), there.long())
    paint = torch.from_numpy(BOX.color_at(found.positions[0][seen].double().numpy())).float() / 255
    assert float((found.colors[0][seen] - paint).abs().mean()) < 0.05
    # Of half the resolution, with nothing but contrast.
    start = POSE[0], map_of(BOX).starts[starts[rows]], look
    half = points_seen_in_starts(ATLAS, map_of(BOX).render_cloud, views, rows, *start, True, 1.0)
    pixel = pixels_towards(look.directions @ POSE[0][0].T, HEIGHT // 2)
    torch.testing.assert_close(half.colors[0], views.contrast[0][1, pixel])


@pytest.mark.parametrize("share", [None, 0.7])
def test_points_of_a_pose_have_the_colours_that_were_compared_mixed_with_contrast(share: float | None) -> None:
    view, look = RigView(ATLAS, 8.0), look_directions(ATLAS, 300, 0.0)
    compared = view.compare(map_of(BOX).render_cloud, *POSE, HEIGHT, is_labels=False)
    extra = torch.full_like(compared.weights, 0.25)
    found = points_seen_by_photos(view, map_of(BOX).render_cloud, compared, *POSE, look, share, extra, 15.0)
    assert bool((known(found.patches).diff() >= 0).all())
    seen = found.weights[0] > 0
    assert set(found.weights[0].tolist()) <= {0.0, 0.25}
    towards = torch.nn.functional.normalize(found.positions[0][seen] - POSE[1], dim=-1) @ POSE[0][0]
    nearest = torch.acos((towards @ look.directions.T).clamp(-1, 1)).amin(1)
    assert float(nearest.max()) < 2 * math.pi / HEIGHT  # each point lies where a photo looks
    window, views = compared.views.window, compared.views
    pixel, _ = window.pixels_towards(towards @ view.rig_from_view)
    shown = (compared.weights > 0).view(views.valid.shape)
    contrast = local_contrast(views.color, shown.float(), window).flatten(1, 2)[0, pixel]
    expected = torch.lerp(compared.scan[0, pixel], contrast, share or 0.0)
    close = (found.colors[0][seen] - expected).abs().amax(-1) < 1e-4
    assert float(close[shown.flatten(1)[0, pixel]].float().mean()) > 0.9  # others lie in the pixel beside
