"""Images as windows of spheres: what they show where, at every resolution, against the definition of their cameras."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.errors import PanoramaUnusableError
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.image.photo_window import shown_share
from panoloc.core.image.rig_pyramid import RigPyramid, Window, Windows
from tests.core.painted_box import rotation_of

CAMERA = Camera.from_hfov("pinhole", 640, 480, 69.0)
FISHEYE = Camera("opencv_fisheye", 600, 600, 170.0, 170.0, 300.0, 300.0, (0.0, 0.0, 0.0, 0.0))
# All around, from the pole overhead down to 36 degrees below the horizon.
UPPER_TURN = Camera("equirectangular", 400, 140, 200 / math.pi, 200 / math.pi, 200.0, 100.0)
SPHERE = Camera.from_hfov("equirectangular", 128, 64, 360.0)


def ramp(camera: Camera) -> Photo:
    """Return a photo whose red grows to the right and whose green grows downwards, by 255 over all of it."""
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    color = np.stack((255 * u / camera.width_px, 255 * v / camera.height_px, np.full_like(u, 90)), axis=-1)
    return Photo(color.round().astype(np.uint8), np.ones(u.shape, bool), camera)


def plain(camera: Camera, value: int = 90) -> Photo:
    shape = camera.height_px, camera.width_px
    return Photo(np.full((*shape, 3), value, np.uint8), np.ones(shape, bool), camera)


def pyramid_of(*photos: Photo, labels: LabelCodes | None = None) -> RigPyramid:
    """Return images that look the same way."""
    here = Pose(np.eye(3), np.zeros(3))
    return RigPyramid(Rig(tuple(RigImage(each, here) for each in photos)), 256, labels, "cpu")


def sampled(
    windows: Windows, color: torch.Tensor, azimuth: np.ndarray, elevation: np.ndarray, image: int = 0
) -> np.ndarray:
    """Return the planes (10, N) that an image has, in some colours, at directions in its own axes, radians."""
    ahead, up = (torch.from_numpy(angle).float()[None] for angle in (azimuth, elevation))
    level = windows.level(color)
    return level.sample(ahead, up, torch.full((1, len(azimuth)), image), level.planes)[0].numpy()


def painted_in(windows: Windows, painted: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> torch.Tensor:
    """Return colours that are a function of azimuth and elevation."""
    x, y, z = windows.directions.double().unbind(-1)
    azimuth, elevation = torch.atan2(y, x).numpy(), torch.atan2(z, torch.hypot(x, y)).numpy()
    return torch.from_numpy(painted(azimuth, elevation)).float()


def directions_within(azimuth_deg: float, elevation_deg: float, count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    azimuth, elevation = np.radians(np.random.default_rng(0).uniform(-1, 1, (2, count)))
    return azimuth * azimuth_deg, elevation * elevation_deg


@pytest.mark.parametrize("image", [0, 1])
def test_a_photo_shows_a_direction_in_the_colour_of_the_pixel_that_its_camera_projects_it_to(image: int) -> None:
    azimuth, elevation = directions_within(30.0, 20.0)
    windows = pyramid_of(ramp(CAMERA), ramp(FISHEYE)).windows(256)
    found = sampled(windows, windows.color, azimuth, elevation, image)
    if image == 0:
        u = 320 - CAMERA.fx_px * np.tan(azimuth)
        v = 240 - CAMERA.fy_px * np.tan(elevation) / np.cos(azimuth)
    else:
        x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
        off_axis = np.arccos(x) / np.hypot(y, z)
        u, v = 300 - 170 * off_axis * y, 300 - 170 * off_axis * z
    camera = (CAMERA, FISHEYE)[image]
    expected = np.stack((u / camera.width_px, v / camera.height_px, np.full_like(u, 90 / 255)))
    np.testing.assert_allclose(found[:3], expected, atol=1.5 / 255)
    assert (found[9] > 0.99).all()


def test_what_a_photo_does_not_show_is_not_valid() -> None:
    azimuth = np.radians([33.0, 36.0, -33.0, -36.0, 0.0, 0.0, 0.0, 0.0, 179.0, -179.0, 0.0, 90.0])
    elevation = np.radians([0.0, 0.0, 0.0, 0.0, 25.5, 29.0, -25.5, -29.0, 0.0, 0.0, 89.9, -89.9])
    windows = pyramid_of(ramp(CAMERA)).windows(256)
    found = sampled(windows, windows.color, azimuth, elevation)[9] > 0.99
    assert found.tolist() == [True, False] * 4 + [False] * 4


def test_an_image_is_kept_at_its_own_resolution_and_enlarged_where_another_is_finer() -> None:
    coarse, fine = plain(SPHERE), plain(CAMERA)
    pyramid = pyramid_of(coarse, fine)
    assert pyramid_of(coarse).finest_rows == 64
    assert pyramid.finest_rows == 256
    enlarged = pyramid.windows(256).each[0]
    assert enlarged.valid.shape == (256, 512)
    assert enlarged.place == SphereWindow(256, 0, 0, 256, 512)


# Halving and masks.


@pytest.mark.parametrize("rows", [32, 64, 128, 256, 512])
def test_masked_pixels_are_not_valid_and_do_not_bleed_at_any_resolution(rows: int) -> None:
    photo = plain(CAMERA)
    photo.valid[:, 320:] = False
    photo.color[:, 320:] = 255
    windows = pyramid_of(photo).windows(rows)
    seen = windows.valid > 0
    np.testing.assert_allclose(windows.color[:, seen], 90 / 255, atol=1e-5)
    assert float(windows.color.max()) < 0.4
    # Left of the middle only: azimuths above zero.
    assert seen.any()
    assert bool((windows.directions[..., 1][seen] > -0.6 * math.pi / rows).all())


@pytest.mark.parametrize("is_masked", [False, True])
def test_half_a_window_has_the_mean_of_the_valid_pixels_of_each_square(is_masked: bool) -> None:
    rng = np.random.default_rng(0)
    color, valid = rng.uniform(size=(3, 12, 20)), np.ones((12, 20))
    if is_masked:
        valid = (rng.uniform(size=valid.shape) < 0.6).astype(float)
    window = Window(torch.from_numpy(color).float(), torch.from_numpy(valid).float(), SphereWindow(64, 8, 16, 12, 20))
    half = window.halved()
    assert half.place == SphereWindow(32, 4, 8, 6, 10)
    for row, column in np.ndindex(6, 10):
        square = slice(2 * row, 2 * row + 2), slice(2 * column, 2 * column + 2)
        is_seen = valid[square] > 0
        assert bool(half.valid[row, column]) == (is_seen.sum() >= 2)
        if is_seen.sum() >= 2:
            expected = color[(slice(None), *square)][:, is_seen].mean(-1)
            np.testing.assert_allclose(half.color[:, row, column].numpy(), expected, atol=1e-6)
    again = half.doubled().halved()
    assert torch.equal(again.valid, half.valid)
    seen = half.valid > 0
    torch.testing.assert_close(again.color[:, seen], half.color[:, seen])


@pytest.mark.parametrize("kept", ["four pixels of ten", "every eighth column", "one pixel"])
def test_a_mask_that_leaves_no_region_is_refused_with_what_to_do(kept: str) -> None:
    photo, valid = plain(CAMERA), np.zeros((480, 640), bool)
    if kept == "four pixels of ten":
        valid = np.random.default_rng(0).uniform(size=valid.shape) < 0.4
    elif kept == "every eighth column":
        valid[:, ::8] = True
    else:
        valid[240, 320] = True
    spoilt = Photo(photo.color, valid, photo.camera)
    with pytest.raises(PanoramaUnusableError, match="mask whole regions"):
        pyramid_of(spoilt)
    assert pyramid_of(spoilt, plain(CAMERA)).share > 0  # another image of the rig shows something


def test_labels_are_those_of_the_nearest_pixels_and_never_mixed() -> None:
    labels = LabelCodes(torch.tensor([[0, 0, 0], [250, 20, 20]]), torch.tensor([[0.1, 0.2, 0.3], [0.9, 0.6, 0.4]]))
    photo = plain(CAMERA, 0)
    stripe = (np.arange(640) // 37) % 2 == 1
    photo.color[:, stripe] = (250, 20, 20)
    photo.color[:100] = (90, 90, 240)  # of no label
    windows = pyramid_of(photo, labels=labels).windows(256)
    x, y, z = np.moveaxis(windows.directions.double().numpy(), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = 320 - CAMERA.fx_px * y / x, 240 - CAMERA.fy_px * z / x
    inside = (x > 0) & (u > 1) & (u < 639) & (v > 101) & (v < 479)
    assert (windows.valid.numpy()[inside] == 1).all()
    assert not windows.valid.numpy()[(x > 0) & (v < 99)].any()
    expected = labels.codes.numpy()[stripe[u[inside].astype(int)].astype(int)].T
    np.testing.assert_array_equal(windows.color.numpy()[:, inside], expected)


def test_an_unknown_label_in_a_panorama_is_masked() -> None:
    labels = LabelCodes(torch.tensor([[255, 0, 0], [0, 0, 255]]), torch.tensor([[0.1, 0.1, 0.1], [0.9, 0.9, 0.9]]))
    photo = plain(SPHERE)
    photo.color[:, :64], photo.color[:, 64:] = (255, 0, 0), (10, 200, 90)
    (window,) = pyramid_of(photo, labels=labels).windows(64).each
    assert bool((window.valid[:, :64] == 1).all())
    assert bool((window.valid[:, 64:] == 0).all())


# Colours and derivatives between pixels, around the seam and over the poles.


@pytest.mark.parametrize("rows", [64, 256])
def test_derivatives_are_those_of_the_colours_by_azimuth_and_elevation(rows: int) -> None:
    def painted(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        return np.stack((np.sin(2 * azimuth + elevation), np.cos(3 * elevation), azimuth * elevation))

    windows = pyramid_of(plain(FISHEYE), plain(CAMERA)).windows(rows)
    azimuth, elevation = directions_within(25.0, 18.0)
    found = sampled(windows, painted_in(windows, painted), azimuth, elevation, 1)
    h, pixel = 1e-5, math.pi / rows
    by_azimuth = (painted(azimuth + h, elevation) - painted(azimuth - h, elevation)) / (2 * h)
    by_elevation = (painted(azimuth, elevation + h) - painted(azimuth, elevation - h)) / (2 * h)
    np.testing.assert_allclose(found[:3], painted(azimuth, elevation), atol=2 * pixel**2)
    np.testing.assert_allclose(found[3:6], by_azimuth, atol=8 * pixel**2)
    np.testing.assert_allclose(found[6:9], by_elevation, atol=8 * pixel**2)


def test_beside_a_mask_derivatives_do_not_see_what_is_under_it() -> None:
    photo = ramp(SPHERE)
    photo.valid[20:30, 40:60] = False
    repainted = Photo(np.where(photo.valid[..., None], photo.color, 255).astype(np.uint8), photo.valid, photo.camera)
    levels = [windows.level(windows.color) for windows in (pyramid_of(each).windows(64) for each in (photo, repainted))]
    seen = levels[0].planes[9] > 0.99
    assert torch.equal(levels[0].planes[:, seen], levels[1].planes[:, seen])
    # The ramp rises by the same at every pixel; beside the mask its derivative is unknown.
    by_azimuth = levels[0].planes[3, 2:-2, 3:-3][21:29]
    assert float(by_azimuth[:, 36].abs().min()) > 0
    assert not by_azimuth[:, [38, 59]].any()


def linear(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return colours (3, ...) that are smooth on all of the sphere: the direction's own coordinates."""
    return np.stack((np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)))


def by_azimuth_and_elevation(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return the derivatives (6, ...) of those colours."""
    x, y, z = linear(azimuth, elevation)
    return np.stack((-y, x, 0 * x, -z * np.cos(azimuth), -z * np.sin(azimuth), np.cos(elevation)))


@pytest.mark.parametrize("camera", [SPHERE, UPPER_TURN], ids=["sphere", "upper part"])
def test_a_full_turn_goes_on_across_its_seam(camera: Camera) -> None:
    windows = pyramid_of(plain(camera), plain(CAMERA)).windows(64)
    azimuth = np.radians(np.array([180, 179.5, 178.6, 177, 160, 0, -160, -177, -178.6, -179.5, -180], float))
    elevation = np.linspace(-0.5, 0.6, len(azimuth))
    found = sampled(windows, painted_in(windows, linear), azimuth, elevation)
    assert (found[9] > 0.99).all()
    np.testing.assert_allclose(found[:3], linear(azimuth, elevation), atol=0.002)
    np.testing.assert_allclose(found[3:9], by_azimuth_and_elevation(azimuth, elevation), atol=0.004)


@pytest.mark.parametrize(
    ("camera", "has_poles"), [(SPHERE, (True, True)), (UPPER_TURN, (True, False)), (CAMERA, (False, False))], ids=str
)
def test_an_image_goes_on_over_the_poles_that_it_has_and_ends_elsewhere(
    camera: Camera, has_poles: tuple[bool, bool]
) -> None:
    windows = pyramid_of(plain(camera)).windows(64)
    azimuth = np.tile(np.linspace(-3, 3, 24), 3)
    for has_pole, sign in zip(has_poles, (1, -1), strict=True):
        elevation = sign * np.repeat(np.radians([89.9, 88.9, 87.0]), 24)
        found = sampled(windows, painted_in(windows, linear), azimuth, elevation)
        assert (found[9] > 0.99).all() == (found[9] > 0).any() == has_pole
        if has_pole:
            np.testing.assert_allclose(found[:3], linear(azimuth, elevation), atol=0.002)


def test_derivatives_turn_round_over_a_pole() -> None:
    windows = pyramid_of(plain(SPHERE)).windows(64)
    azimuth = np.tile(np.linspace(-3, 3, 24), 2)
    for sign in (1, -1):
        elevation = sign * np.repeat(np.radians([89.8, 89.0]), 24)  # nearer than the middle of the last row
        found = sampled(windows, painted_in(windows, linear), azimuth, elevation)
        np.testing.assert_allclose(found[3:9], by_azimuth_and_elevation(azimuth, elevation), atol=0.01)


# Several images.

TURNS = np.eye(3), rotation_of(100.0, -20.0, 30.0), rotation_of(-120.0, 40.0)
PLACES = np.array([[0.3, 0.0, 1.0], [0.0, 0.6, 1.2], [-0.6, 0.3, 0.5]])


def rig_of_three() -> Rig:
    """Return a wide photo, a tall one and one through a fisheye, taken from three places."""
    fisheye = Camera("opencv_fisheye", 600, 600, 400.0, 400.0, 300.0, 300.0, (0.0, 0.0, 0.0, 0.0))
    cameras = CAMERA, Camera.from_hfov("pinhole", 300, 500, 45.0), fisheye
    poses = (Pose(turn, place) for turn, place in zip(TURNS, PLACES, strict=True))
    return Rig(tuple(RigImage(ramp(camera), pose) for camera, pose in zip(cameras, poses, strict=True)))


def test_each_image_of_a_rig_is_in_its_axes_and_from_the_middle_of_the_cameras() -> None:
    pyramid = RigPyramid(rig_of_three(), 256, None, "cpu")
    np.testing.assert_allclose(pyramid.centers.numpy(), PLACES - PLACES.mean(0), atol=1e-6)
    windows = pyramid.windows(128)
    for number, (turn, window) in enumerate(zip(TURNS, windows.each, strict=True)):
        own = windows.image == number
        seen = own & (windows.valid > 0)
        assert int(seen.sum()) == int(window.valid.sum()) > 0
        expected = windows.directions[seen].double().numpy() @ turn.T
        np.testing.assert_allclose(windows.rig_directions[seen].numpy(), expected, atol=1e-5)
        # No image shows anything outside of its cone, which is no wider than it has to be.
        off_axis = windows.directions[seen][:, 0].clamp(-1, 1).acos().max()
        assert float(off_axis) <= float(pyramid.cones[number]) <= float(off_axis) + 0.1


def test_planes_of_windows_are_packed_apart_and_come_back() -> None:
    windows = RigPyramid(rig_of_three(), 256, None, "cpu").windows(64)
    planes = [torch.rand((2, *each.valid.shape)) + 1 for each in windows.each]
    packed = windows.packed(planes)
    assert packed.shape == (2, *windows.shape)
    for given, found in zip(planes, windows.inside(packed), strict=True):
        assert torch.equal(given, found)
    assert int((packed[0] > 0).sum()) == sum(plane[0].numel() for plane in planes)


def test_solid_angles_of_a_sphere_are_all_of_it_and_of_a_photo_those_of_its_camera() -> None:
    windows = pyramid_of(plain(SPHERE), plain(CAMERA)).windows(256)
    sphere, photo = (float(each.sum()) for each in windows.inside(windows.weights))
    assert sphere == pytest.approx(4 * math.pi, rel=1e-5)
    across, down = 320 / CAMERA.fx_px, 240 / CAMERA.fy_px
    # Of a rectangle seen from above its middle.
    assert photo == pytest.approx(4 * math.atan(across * down / math.sqrt(1 + across**2 + down**2)), rel=0.02)


def shown_by(rig: Rig, directions: np.ndarray) -> np.ndarray:
    """Tell which directions (N, 3) in the rig's axes the pinholes and the fisheye of three show."""
    shown = np.zeros(len(directions), bool)
    for number, (image, turn) in enumerate(zip(rig.images, TURNS, strict=True)):
        camera, (x, y, z) = image.photo.camera, (directions @ turn).T
        off_axis = np.arccos(x.clip(-1, 1)) / np.maximum(np.hypot(y, z), 1e-9)
        scale = off_axis if number == 2 else 1 / np.where(x > 0.05, x, np.nan)
        u, v = camera.cx_px - camera.fx_px * y * scale, camera.cy_px - camera.fy_px * z * scale
        shown |= (u > 0) & (u < camera.width_px) & (v > 0) & (v < camera.height_px)
    return shown


def test_a_rig_shows_what_one_of_its_images_shows() -> None:
    rig, directions = rig_of_three(), even_directions(4000)
    pyramid, exact = RigPyramid(rig, 256, None, "cpu"), shown_by(rig, directions.double().numpy())
    assert 0.2 < exact.mean() < 0.5
    assert (pyramid.shows(directions).numpy() != exact).mean() < 0.02
    assert pyramid.share == pytest.approx(exact.mean(), rel=0.03)
    assert shown_share(rig) == pytest.approx(exact.mean(), rel=0.03)


@pytest.mark.parametrize("margin_deg", [0.0, 15.0])
def test_what_a_rig_shows_or_almost_is_known_to_a_pixel_of_three_degrees(margin_deg: float) -> None:
    rig, directions, dense = rig_of_three(), even_directions(2000), even_directions(30_000)
    exact = dense[torch.from_numpy(shown_by(rig, dense.double().numpy()))]
    found = RigPyramid(rig, 256, None, "cpu").shows(directions, math.radians(margin_deg))
    off_deg = torch.rad2deg((directions @ exact.T).amax(1).clamp(max=1).acos())
    beyond = off_deg > margin_deg + 3.0
    assert bool(found[off_deg <= margin_deg - 3.0].all())
    assert bool(beyond.any())
    assert not bool(found[beyond].any())


def test_all_that_a_rig_shows_is_within_reach_of_its_first_optical_axis() -> None:
    rig, dense = rig_of_three(), even_directions(30_000)
    exact = dense[torch.from_numpy(shown_by(rig, dense.double().numpy()))]
    pyramid = RigPyramid(rig, 256, None, "cpu")
    farthest = float((exact @ pyramid.rotations[0, :, 0]).min().acos())
    assert farthest <= pyramid.reach < farthest + math.radians(30.0)


def test_a_panorama_shows_everything_and_directions_shown_are_those_of_valid_pixels() -> None:
    assert pyramid_of(plain(SPHERE)).share == 1.0
    assert shown_share(Rig.of_panorama(Panorama(plain(SPHERE).color, plain(SPHERE).valid))) == pytest.approx(
        1.0, abs=1e-3
    )
    half = plain(SPHERE)
    half.valid[:, :64] = False  # of the left
    windows = pyramid_of(half).windows(128)
    shown = windows.rig_directions[windows.valid > 0]
    assert len(shown) == 128 * 128
    assert float(shown[:, 1].max()) < 0
