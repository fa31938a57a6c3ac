"""Photos as windows of spheres: what they show where, at every resolution, against the definition of their cameras."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Photo, Session, SessionImage
from panoloc.core.errors import PanoramaUnusableError
from panoloc.core.features.equalization import LabelCodes
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.image.photo_colors import PhotoContrast
from panoloc.core.image.photo_level import PhotoWindows
from tests.core.painted_box import rotation_of

CAMERA = Camera.from_hfov("pinhole", 640, 480, 69.0)
FISHEYE = Camera("opencv_fisheye", 600, 600, 170.0, 170.0, 300.0, 300.0, (0.0, 0.0, 0.0, 0.0))


def ramp(camera: Camera) -> Photo:
    """Return a photo whose red grows to the right and whose green grows downwards, by 255 over all of it."""
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    color = np.stack((255 * u / camera.width_px, 255 * v / camera.height_px, np.full_like(u, 90)), axis=-1)
    return Photo(color.round().astype(np.uint8), np.ones(u.shape, bool), camera)


def plain(camera: Camera, value: int = 90) -> Photo:
    shape = camera.height_px, camera.width_px
    return Photo(np.full((*shape, 3), value, np.uint8), np.ones(shape, bool), camera)


def atlas_of(*photos: Photo, labels: LabelCodes | None = None) -> PhotoAtlas:
    """Return photos that look the same way."""
    here = Pose(np.eye(3), np.zeros(3))
    return PhotoAtlas(Session(tuple(SessionImage(each, here) for each in photos)), 256, labels, "cpu")


def sampled(
    windows: PhotoWindows, color: torch.Tensor, azimuth: np.ndarray, elevation: np.ndarray, photo: int = 0
) -> np.ndarray:
    """Return the planes (10, N) that a photo has, in some colours, at directions in its own axes, radians."""
    ahead, up = (torch.from_numpy(angle).float()[None] for angle in (azimuth, elevation))
    return windows.level(color).sample(ahead, up, torch.full((1, len(azimuth)), photo))[0].numpy()


def painted_in(windows: PhotoWindows, painted: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> torch.Tensor:
    """Return colours that are a function of azimuth and elevation."""
    x, y, z = windows.direction.double().numpy()
    return torch.from_numpy(painted(np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))).float()


def directions_within(azimuth_deg: float, elevation_deg: float, count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    azimuth, elevation = np.radians(np.random.default_rng(0).uniform(-1, 1, (2, count)))
    return azimuth * azimuth_deg, elevation * elevation_deg


@pytest.mark.parametrize("photo", [0, 1])
def test_a_photo_shows_a_direction_in_the_colour_of_the_pixel_that_its_camera_projects_it_to(photo: int) -> None:
    azimuth, elevation = directions_within(30.0, 20.0)
    windows = atlas_of(ramp(CAMERA), ramp(FISHEYE)).windows(256)
    found = sampled(windows, windows.color, azimuth, elevation, photo)
    if photo == 0:
        u = 320 - CAMERA.fx_px * np.tan(azimuth)
        v = 240 - CAMERA.fy_px * np.tan(elevation) / np.cos(azimuth)
    else:
        x, y, z = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
        off_axis = np.arccos(x) / np.hypot(y, z)
        u, v = 300 - 170 * off_axis * y, 300 - 170 * off_axis * z
    camera = (CAMERA, FISHEYE)[photo]
    expected = np.stack((u / camera.width_px, v / camera.height_px, np.full_like(u, 90 / 255)))
    np.testing.assert_allclose(found[:3], expected, atol=1.5 / 255)
    assert (found[9] > 0.99).all()


def test_what_a_photo_does_not_show_is_not_valid() -> None:
    azimuth = np.radians([33.0, 36.0, -33.0, -36.0, 0.0, 0.0, 0.0, 0.0, 179.0, -179.0, 0.0, 90.0])
    elevation = np.radians([0.0, 0.0, 0.0, 0.0, 25.5, 29.0, -25.5, -29.0, 0.0, 0.0, 89.9, -89.9])
    windows = atlas_of(ramp(CAMERA)).windows(256)
    found = sampled(windows, windows.color, azimuth, elevation)[9] > 0.99
    assert found.tolist() == [True, False] * 4 + [False] * 4


@pytest.mark.parametrize("rows", [32, 64, 128, 256, 512])
def test_masked_pixels_are_not_valid_and_do_not_bleed_at_any_resolution(rows: int) -> None:
    photo = plain(CAMERA)
    photo.valid[:, 320:] = False
    photo.color[:, 320:] = 255
    windows = atlas_of(photo).windows(rows)
    seen = windows.valid > 0
    np.testing.assert_allclose(windows.color[:, seen], 90 / 255, atol=1e-5)
    assert float(windows.color.max()) < 0.4
    # Left of the middle only: azimuths above zero.
    assert seen.any()
    assert bool((windows.direction[1][seen] > -0.6 * math.pi / rows).all())


@pytest.mark.parametrize("rows", [64, 256])
def test_derivatives_are_those_of_the_colours_by_azimuth_and_elevation(rows: int) -> None:
    def painted(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        return np.stack((np.sin(2 * azimuth + elevation), np.cos(3 * elevation), azimuth * elevation))

    windows = atlas_of(plain(FISHEYE), plain(CAMERA)).windows(rows)
    azimuth, elevation = directions_within(25.0, 18.0)
    found = sampled(windows, painted_in(windows, painted), azimuth, elevation, 1)
    h, pixel = 1e-5, math.pi / rows
    by_azimuth = (painted(azimuth + h, elevation) - painted(azimuth - h, elevation)) / (2 * h)
    by_elevation = (painted(azimuth, elevation + h) - painted(azimuth, elevation - h)) / (2 * h)
    np.testing.assert_allclose(found[:3], painted(azimuth, elevation), atol=2 * pixel**2)
    np.testing.assert_allclose(found[3:6], by_azimuth, atol=8 * pixel**2)
    np.testing.assert_allclose(found[6:9], by_elevation, atol=8 * pixel**2)


def test_a_full_turn_goes_on_across_its_seam() -> None:
    def painted(azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        return np.stack((np.sin(azimuth), np.cos(2 * azimuth), np.sin(elevation)))

    sphere = Panorama(np.full((64, 128, 3), 90, np.uint8), np.ones((64, 128), bool))
    windows = atlas_of(Photo.of_panorama(sphere), plain(CAMERA)).windows(64)
    azimuth = np.radians(np.array([180, 179.5, 178.6, 177, 160, 0, -160, -177, -178.6, -179.5, -180], float))
    elevation = np.linspace(-0.6, 0.6, len(azimuth))
    found = sampled(windows, painted_in(windows, painted), azimuth, elevation)
    assert (found[9] > 0.99).all()
    np.testing.assert_allclose(found[:3], painted(azimuth, elevation), atol=0.01)
    by_azimuth = np.stack((np.cos(azimuth), -2 * np.sin(2 * azimuth), np.zeros_like(azimuth)))
    np.testing.assert_allclose(found[3:6], by_azimuth, atol=0.03)


def test_labels_are_those_of_the_nearest_pixels_and_never_mixed() -> None:
    labels = LabelCodes(torch.tensor([[0, 0, 0], [250, 20, 20]]), torch.tensor([[0.1, 0.2, 0.3], [0.9, 0.6, 0.4]]))
    photo = plain(CAMERA, 0)
    stripe = (np.arange(640) // 37) % 2 == 1
    photo.color[:, stripe] = (250, 20, 20)
    photo.color[:100] = (90, 90, 240)  # of no label
    windows = atlas_of(photo, labels=labels).windows(256)
    x, y, z = windows.direction.double().numpy()
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = 320 - CAMERA.fx_px * y / x, 240 - CAMERA.fy_px * z / x
    inside = (x > 0) & (u > 1) & (u < 639) & (v > 101) & (v < 479)
    assert (windows.valid.numpy()[inside] == 1).all()
    assert not windows.valid.numpy()[(x > 0) & (v < 99)].any()
    expected = labels.codes.numpy()[stripe[u[inside].astype(int)].astype(int)].T
    np.testing.assert_array_equal(windows.color.numpy()[:, inside], expected)


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
        atlas_of(spoilt)
    assert float(atlas_of(spoilt, plain(CAMERA)).share()) > 0  # another photo of the session shows something


def test_each_photo_is_held_against_its_own_surroundings() -> None:
    """A plain photo has no contrast, however bright the others are that look elsewhere."""
    behind = Pose(rotation_of(180.0, 0.0, 0.0), np.zeros(3))
    session = Session(
        (SessionImage(plain(CAMERA, 30), Pose(np.eye(3), np.zeros(3))), SessionImage(plain(CAMERA, 200), behind))
    )
    atlas = PhotoAtlas(session, 256, None, "cpu")
    windows = atlas.windows(64)
    contrast = PhotoContrast(atlas).of_windows(windows)
    for number in range(2):
        seen = (windows.valid > 0) & (windows.photo == number)
        torch.testing.assert_close(contrast[:, seen], torch.full_like(contrast[:, seen], 0.5), atol=0.02, rtol=0)
