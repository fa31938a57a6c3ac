"""Points sampled in images with centres of their own: places, colours and derivatives by the pose of the rig and the focal length."""

import math

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import even_directions, rotation_from_vector, uniform_rotations
from panoloc.core.image.level import Level
from panoloc.core.image.rig_pyramid import RigPyramid
from tests.core.painted_box import rotation_of

POSES = (
    Pose(rotation_of(20.0, 10.0, 30.0), np.array([0.3, 0.1, -0.1])),
    Pose(rotation_of(-80.0, -20.0, 5.0), np.array([-0.4, 0.2, 0.1])),
    Pose(rotation_of(150.0, 35.0, -60.0), np.array([0.1, -0.3, 0.0])),
)
CAMERA = Camera.from_hfov("pinhole", 320, 240, 80.0)
SPHERE = Camera.from_hfov("equirectangular", 512, 256, 360.0)
ROWS = 256
ROTATION, POSITION = uniform_rotations(9)[5], torch.tensor([0.4, -0.2, 1.1])
SEVERAL = pytest.mark.parametrize("count", [1, 3], ids=["one image", "three images"])


def painted(directions: torch.Tensor, image: torch.Tensor | int) -> torch.Tensor:
    """Return the colours (..., 3) that an image shows along directions (..., 3) of its own axes."""
    x, y, z = directions.unbind(-1)
    waves = torch.stack(((3 * x + 2 * y).sin(), (4 * y - z).sin(), (3 * z + 2 * y).cos()), dim=-1)
    return 0.5 + 0.3 * waves * (1 + 0.3 * torch.as_tensor(image))[..., None]


def level_of(count: int, camera: Camera = CAMERA) -> Level:
    """Return the first of the images, painted."""
    shape = camera.height_px, camera.width_px
    blank = Photo(np.full((*shape, 3), 90, np.uint8), np.ones(shape, bool), camera)
    rig = Rig(tuple(RigImage(blank, pose) for pose in POSES[:count]))
    windows = RigPyramid(rig, ROWS, None, "cpu").windows(ROWS)
    return windows.level(painted(windows.directions, windows.image).permute(2, 0, 1).contiguous())


def middle_of(count: int) -> np.ndarray:
    return np.asarray(np.mean([pose.position for pose in POSES[:count]], axis=0))


def points_in_view(count: int, of: int = 300) -> tuple[torch.Tensor, torch.Tensor]:
    """Return points (1, 3, N) 1 to 4 m before the images (1, N) that show them, of the rig at ROTATION and POSITION."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, count, of)
    left, up, depth = rng.uniform(-0.6, 0.6, of), rng.uniform(-0.4, 0.4, of), rng.uniform(1, 4, of)
    in_camera = np.stack((np.ones(of), left, up), axis=-1) * depth[:, None]
    turned = [POSES[k].rotation @ p + POSES[k].position for k, p in zip(image, in_camera, strict=True)]
    in_map = (np.stack(turned) - middle_of(count)) @ ROTATION.double().numpy().T + POSITION.double().numpy()
    return torch.from_numpy(in_map.T[None]).float(), torch.from_numpy(image)[None]


def exact_colors(
    count: int, place: torch.Tensor, images: torch.Tensor, change: torch.Tensor, log_focal: float = 0.0
) -> torch.Tensor:
    """Return the colours (N, 3), in double precision, at the true pose turned and moved by `change` (6,) in the rig's own frame.

    log_focal: of the factor by which all focal lengths are longer than those that the images were painted for.
    """
    rotation = ROTATION.double() @ rotation_from_vector(change[:3])
    position = POSITION.double() + ROTATION.double() @ change[3:]
    in_rig = (place[0].double().T - position) @ rotation
    rotations = torch.from_numpy(np.stack([pose.rotation for pose in POSES]))[images[0]]
    centers = torch.from_numpy(np.stack([pose.position for pose in POSES]) - middle_of(count))[images[0]]
    in_camera = torch.einsum("nab,na->nb", rotations, in_rig - centers)
    in_camera = in_camera * torch.tensor([1.0, math.exp(log_focal), math.exp(log_focal)])
    return painted(torch.nn.functional.normalize(in_camera, dim=-1), images[0])


def at_rest() -> torch.Tensor:
    return torch.zeros(6, dtype=torch.float64)


@SEVERAL
def test_each_point_has_the_colour_that_its_own_image_shows_of_it(count: int) -> None:
    place, images = points_in_view(count)
    level = level_of(count)
    seen, inside = level.sample_points(place, images, ROTATION[None], POSITION[None])
    assert bool(inside.all())
    expected = exact_colors(count, place, images, at_rest()).T.float()
    torch.testing.assert_close(seen.color[0], expected, atol=1e-3, rtol=0)
    if count > 1:
        wrong, _ = level.sample_points(place, (images + 1) % count, ROTATION[None], POSITION[None])
        assert float((wrong.color[0] - expected).abs().mean()) > 0.1
    else:
        alone, as_inside = level.sample_points(place, None, ROTATION[None], POSITION[None])
        torch.testing.assert_close(alone.planes, seen.planes, atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(alone.directions, seen.directions, atol=1e-5, rtol=1e-4)
        assert torch.equal(as_inside, inside)


@SEVERAL
@pytest.mark.parametrize("log_focal", [None, 0.08, -0.05])
def test_derivatives_are_those_of_finite_differences(count: int, log_focal: float | None) -> None:
    place, images = points_in_view(count)
    log = None if log_focal is None else torch.tensor([log_focal])
    given = images if count > 1 else None
    seen, inside = level_of(count).sample_points(place, given, ROTATION[None], POSITION[None], log)
    found = torch.einsum("kcdn,kpdn->kpcn", seen.derivatives, seen.directions)[0]
    around = 0.0 if log_focal is None else log_focal
    number, small = 6 if log_focal is None else 7, 1e-5
    assert len(found) == number
    assert float(inside.float().mean()) > 0.9  # a longer focal length moves some over the border
    chosen = inside[0]
    for parameter in range(number):
        change = torch.zeros(7, dtype=torch.float64)
        change[parameter] = small
        ahead, behind = (
            exact_colors(count, place, images, step[:6], around + float(step[6])) for step in (change, -change)
        )
        expected = ((ahead - behind) / (2 * small)).T.float()
        assert float(expected.abs().max()) > 0.3
        torch.testing.assert_close(found[parameter][:, chosen], expected[:, chosen], atol=3e-3, rtol=3e-3)


def test_a_focal_length_that_is_not_longer_changes_nothing_else() -> None:
    place, images = points_in_view(3)
    pose = ROTATION[None], POSITION[None]
    same = level_of(3).sample_points(place, images, *pose)[0]
    none = level_of(3).sample_points(place, images, *pose, torch.zeros(1))[0]
    torch.testing.assert_close(none.planes, same.planes)
    torch.testing.assert_close(none.directions[:, :6], same.directions)


def test_points_behind_an_image_and_beside_it_are_not_inside() -> None:
    place, images = points_in_view(3)
    level = level_of(3)
    middle = torch.einsum("ab,nb->na", ROTATION, level.centers[images[0]]).T[None] + POSITION[:, None]
    _, behind = level.sample_points(2 * middle - place, images, ROTATION[None], POSITION[None])
    assert not bool(behind.any())
    aside = ROTATION[None] @ rotation_from_vector(torch.tensor([[0.0, 0.0, math.pi / 2]]))
    _, beside = level.sample_points(place, torch.zeros_like(images), aside, POSITION[None])
    assert not bool(beside[images == 0].any())


@SEVERAL
@pytest.mark.parametrize("focals", [None, torch.tensor([0.1, -0.05])], ids=["known", "unknown"])
def test_each_of_several_candidates_is_sampled_at_its_own_pose_and_focal_length(
    count: int, focals: torch.Tensor | None
) -> None:
    place, images = points_in_view(count)
    level = level_of(count)
    rotations = torch.stack((ROTATION, ROTATION @ rotation_from_vector(torch.tensor([0.03, -0.02, 0.05]))))
    positions = torch.stack((POSITION, POSITION + torch.tensor([0.05, 0.0, -0.04])))
    given = images if count > 1 else None
    twice = None if given is None else given.expand(2, -1)
    both, inside = level.sample_points(place.expand(2, -1, -1), twice, rotations, positions, focals)
    for k in range(2):
        one = slice(k, k + 1)
        log = None if focals is None else focals[one]
        alone, valid = level.sample_points(place, given, rotations[one], positions[one], log)
        torch.testing.assert_close(both.planes[k], alone.planes[0], atol=1e-4, rtol=1e-4)
        torch.testing.assert_close(both.directions[k], alone.directions[0], atol=1e-4, rtol=1e-4)
        assert torch.equal(inside[k], valid[0])


def test_a_sphere_has_every_point_around_its_seam_and_nearly_to_its_poles() -> None:
    directions = even_directions(3000)
    directions = directions[directions[:, 2].abs() < 0.995]  # nearer to a pole the derivative by azimuth is bounded
    distances = 1 + 3 * torch.rand((len(directions), 1), generator=torch.Generator().manual_seed(1))
    in_rig = (distances * directions) @ torch.from_numpy(POSES[0].rotation).float().T
    place = (in_rig @ ROTATION.T + POSITION).T[None].contiguous()
    seen, inside = level_of(1, SPHERE).sample_points(place, None, ROTATION[None], POSITION[None])
    assert bool(inside.all())
    images = torch.zeros((1, len(directions)), dtype=torch.int64)
    expected = exact_colors(1, place, images, at_rest()).T.float()
    torch.testing.assert_close(seen.color[0], expected, atol=1e-3, rtol=0)
    found = torch.einsum("kcdn,kpdn->kpcn", seen.derivatives, seen.directions)[0]
    for parameter in range(6):
        change = at_rest()
        change[parameter] = 1e-5
        ahead, behind = (exact_colors(1, place, images, step) for step in (change, -change))
        torch.testing.assert_close(found[parameter], ((ahead - behind) / 2e-5).T.float(), atol=5e-3, rtol=5e-3)


def test_a_panorama_is_the_rig_of_a_sphere() -> None:
    panorama = Panorama(np.full((64, 128, 3), 90, np.uint8), np.ones((64, 128), bool))
    (image,) = Rig.of_panorama(panorama).images
    assert image.photo.camera.is_whole_sphere
    windows = RigPyramid(Rig.of_panorama(panorama), ROWS, None, "cpu").windows(64)
    azimuth, elevation = torch.tensor([[3.1, -3.1, 0.4]]), torch.tensor([[0.0, 1.2, -1.5]])
    found = windows.level(windows.color).sample(azimuth, elevation, 0)
    torch.testing.assert_close(found[0, :3], torch.full((3, 3), 90 / 255))
    assert bool((found[0, 3] > 0.99).all())
