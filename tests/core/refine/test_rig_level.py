"""Points sampled in photos with centres of their own: places, colours and derivatives by the pose of the rig."""

import math

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Photo, Session, SessionImage
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.geometry.rotations import even_directions, rotation_from_vector, uniform_rotations
from panoloc.core.image.image_level import prepare_level
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.refine.point_sampling import sample_points
from panoloc.core.refine.rig_level import RigLevel
from tests.core.painted_box import rotation_of
from tests.core.refine.painted_scene import at_distances

POSES = (
    Pose(rotation_of(20.0, 10.0, 30.0), np.array([0.3, 0.1, -0.1])),
    Pose(rotation_of(-80.0, -20.0, 5.0), np.array([-0.4, 0.2, 0.1])),
    Pose(rotation_of(150.0, 35.0, -60.0), np.array([0.1, -0.3, 0.0])),
)
CAMERA = Camera.from_hfov("pinhole", 320, 240, 80.0)
ROWS = 256
ROTATION, POSITION = uniform_rotations(9)[5], torch.tensor([0.4, -0.2, 1.1])


def painted(directions: torch.Tensor, photo: torch.Tensor | int) -> torch.Tensor:
    """Return the colours (..., 3) that a photo shows along directions (..., 3) of its own axes."""
    x, y, z = directions.unbind(-1)
    waves = torch.stack(((3 * x + 2 * y).sin(), (4 * y - z).sin(), (3 * z + 2 * y).cos()), dim=-1)
    return 0.5 + 0.3 * waves * (1 + 0.3 * torch.as_tensor(photo))[..., None]


def rig() -> RigLevel:
    """Return three photos, painted."""
    blank = Photo(np.full((240, 320, 3), 90, np.uint8), np.ones((240, 320), bool), CAMERA)
    atlas = PhotoAtlas(Session(tuple(SessionImage(blank, pose) for pose in POSES)), ROWS, None, "cpu")
    windows = atlas.windows(ROWS)
    level = windows.level(painted(windows.direction.permute(1, 2, 0), windows.photo).permute(2, 0, 1).contiguous())
    return RigLevel(level, atlas.rotations, atlas.centers)


def points_in_view(count: int = 300) -> tuple[torch.Tensor, torch.Tensor]:
    """Return points (1, 3, N) 1 to 4 m before the photos (1, N) that show them, of the rig at ROTATION and POSITION."""
    rng = np.random.default_rng(0)
    photo = rng.integers(0, 3, count)
    left, up, depth = rng.uniform(-0.6, 0.6, count), rng.uniform(-0.4, 0.4, count), rng.uniform(1, 4, count)
    in_camera = np.stack((np.ones(count), left, up), axis=-1) * depth[:, None]
    middle = np.mean([pose.position for pose in POSES], axis=0)
    in_rig = np.stack(
        [POSES[k].rotation @ p + POSES[k].position - middle for k, p in zip(photo, in_camera, strict=True)]
    )
    in_map = in_rig @ ROTATION.double().numpy().T + POSITION.double().numpy()
    return torch.from_numpy(in_map.T[None]).float(), torch.from_numpy(photo)[None]


def exact_colors(place: torch.Tensor, photos: torch.Tensor, turn: torch.Tensor, move: torch.Tensor) -> torch.Tensor:
    """Return the colours (N, 3) in double precision at the true pose turned and moved in the rig's own frame, and their angles."""
    rotation = ROTATION.double() @ rotation_from_vector(turn)
    position = POSITION.double() + ROTATION.double() @ move
    middle = np.mean([pose.position for pose in POSES], axis=0)
    in_rig = (place[0].double().T - position) @ rotation
    rotations = torch.from_numpy(np.stack([pose.rotation for pose in POSES]))[photos[0]]
    centers = torch.from_numpy(np.stack([pose.position - middle for pose in POSES]))[photos[0]]
    in_camera = torch.einsum("nab,na->nb", rotations, in_rig - centers)
    return painted(torch.nn.functional.normalize(in_camera, dim=-1), photos[0])


def test_each_point_has_the_colour_that_its_own_photo_shows_of_it() -> None:
    place, photos = points_in_view()
    seen, inside = rig().sample_points(place, photos, ROTATION[None], POSITION[None])
    assert bool(inside.all())
    none = torch.zeros(3, dtype=torch.float64)
    expected = exact_colors(place, photos, none, none).T.float()
    torch.testing.assert_close(seen.color[0], expected, atol=1e-3, rtol=0)
    wrong, _ = rig().sample_points(place, (photos + 1) % 3, ROTATION[None], POSITION[None])
    assert float((wrong.color[0] - expected).abs().mean()) > 0.1


@pytest.mark.parametrize("parameter", range(6))
def test_derivatives_by_turn_and_move_are_those_of_finite_differences(parameter: int) -> None:
    place, photos = points_in_view()
    seen, _ = rig().sample_points(place, photos, ROTATION[None], POSITION[None])
    found = torch.einsum("kcdn,kpdn->kpcn", seen.derivatives, seen.directions)[0, parameter]
    step = torch.zeros(6, dtype=torch.float64)
    step[parameter] = 1e-5
    ahead, behind = (exact_colors(place, photos, s[:3], s[3:]) for s in (step, -step))
    expected = ((ahead - behind) / 2e-5).T.float()
    assert float(expected.abs().max()) > 0.3
    torch.testing.assert_close(found, expected, atol=3e-3, rtol=3e-3)


def test_points_behind_a_photo_and_beside_it_are_not_inside() -> None:
    place, photos = points_in_view()
    level = rig()
    middle = torch.einsum("ab,nb->na", ROTATION, level.centers[photos[0]]).T[None] + POSITION[:, None]
    _, behind = level.sample_points(2 * middle - place, photos, ROTATION[None], POSITION[None])
    assert not bool(behind.any())
    aside = ROTATION[None] @ rotation_from_vector(torch.tensor([[0.0, 0.0, math.pi / 2]]))
    _, beside = level.sample_points(place, torch.zeros_like(photos), aside, POSITION[None])
    assert not bool(beside[photos == 0].any())


def test_each_of_several_candidates_is_sampled_at_its_own_pose() -> None:
    place, photos = points_in_view()
    level = rig()
    rotations = torch.stack((ROTATION, ROTATION @ rotation_from_vector(torch.tensor([0.03, -0.02, 0.05]))))
    positions = torch.stack((POSITION, POSITION + torch.tensor([0.05, 0.0, -0.04])))
    both, inside = level.sample_points(place.expand(2, -1, -1), photos.expand(2, -1), rotations, positions)
    for k in range(2):
        alone, valid = level.sample_points(place, photos, rotations[k : k + 1], positions[k : k + 1])
        torch.testing.assert_close(both.planes[k], alone.planes[0], atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(both.directions[k], alone.directions[0], atol=1e-4, rtol=1e-4)
        assert torch.equal(inside[k], valid[0])


def test_a_sphere_as_a_photo_is_sampled_as_a_panorama_is() -> None:
    rows = 64
    image = painted(pixel_directions(rows, 2 * rows), 0).permute(2, 0, 1).contiguous()
    panorama = prepare_level(image, torch.ones((rows, 2 * rows)))
    sphere = Photo.of_panorama(Panorama(np.full((rows, 2 * rows, 3), 90, np.uint8), np.ones((rows, 2 * rows), bool)))
    atlas = PhotoAtlas(Session.of_photo(sphere), rows, None, "cpu")
    windows = atlas.windows(rows)
    color = painted(windows.direction.permute(1, 2, 0), 0).permute(2, 0, 1).contiguous()
    level = RigLevel(windows.level(color), atlas.rotations, atlas.centers)
    directions = even_directions(900)
    directions = directions[directions[:, 2].abs() < 0.99]
    place = (POSITION + at_distances(directions) @ ROTATION.T).T[None].contiguous()
    expected, all_inside = sample_points(panorama, place, ROTATION[None], POSITION[None])
    for photos in (None, torch.zeros((1, len(directions)), dtype=torch.int64)):
        found, inside = level.sample_points(place, photos, ROTATION[None], POSITION[None])
        assert torch.equal(inside, all_inside)
        torch.testing.assert_close(found.planes, expected.planes, atol=2e-4, rtol=1e-3)
        torch.testing.assert_close(found.directions, expected.directions, atol=1e-5, rtol=1e-4)


def test_a_longer_focal_length_spreads_what_is_beside_the_axis_of_each_photo() -> None:
    place, photos = points_in_view()
    level, log = rig(), 0.08
    small = 1e-3
    at, before, after = (
        level.sample_points(place, photos, ROTATION[None], POSITION[None], torch.tensor(log + change))[0]
        for change in (0.0, -small, small)
    )
    assert at.directions.shape[1] == 7
    # Colours change by the derivative along which they are looked up: the seventh direction.
    expected = (after.color - before.color) / (2 * small)
    slope = (at.derivatives * at.directions[:, 6][:, None]).sum(2)
    error = (slope - expected).abs().median()
    assert float(error) < 0.05 * float(expected.abs().median())
    same = level.sample_points(place, photos, ROTATION[None], POSITION[None])[0]
    none = level.sample_points(place, photos, ROTATION[None], POSITION[None], torch.zeros(()))[0]
    torch.testing.assert_close(none.planes, same.planes)
    torch.testing.assert_close(none.directions[:, :6], same.directions)
