"""Canonical colours of the images of a rig, against slow definitions and against the sphere that they are parts of."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.image.rig_pyramid import RigPyramid
from tests.core.painted_box import rotation_of

CAMERA = Camera.from_hfov("pinhole", 640, 480, 69.0)
ROWS = 64


def plain(value: int) -> Photo:
    return Photo(np.full((480, 640, 3), value, np.uint8), np.ones((480, 640), bool), CAMERA)


def textured(seed: int = 0) -> Panorama:
    """Return a panorama with detail at the size of a few pixels, a part of it masked."""
    rng = np.random.default_rng(seed)
    color = rng.integers(0, 256, (ROWS // 2, ROWS, 3)).repeat(2, axis=0).repeat(2, axis=1)
    valid = np.ones((ROWS, 2 * ROWS), bool)
    valid[10:24, 30:50] = False
    return Panorama(color.astype(np.uint8), valid)


def colors_of(rig: Rig, labels: LabelCodes | None = None) -> CanonicalColors:
    return CanonicalColors(RigPyramid(rig, 256, labels, "cpu"))


def two_halves() -> tuple[Rig, Rig]:
    """Return a panorama, and the same as two images that were turned by a right angle and show half of it each."""
    whole, quarter = textured(), ROWS // 2
    left = np.zeros_like(whole.valid)
    left[:, :ROWS] = True
    # A camera turned to the left by a right angle has the same columns a quarter farther to the right.
    turned = Panorama(np.roll(whole.color, quarter, axis=1), np.roll(whole.valid & ~left, quarter, axis=1))
    photos = Photo.of_panorama(replace(whole, valid=whole.valid & left)), Photo.of_panorama(turned)
    poses = (Pose(rotation_of(yaw), np.zeros(3)) for yaw in (0.0, 90.0))
    return Rig.of_panorama(whole), Rig(tuple(RigImage(*both) for both in zip(photos, poses, strict=True)))


def joined(parts: list[torch.Tensor]) -> torch.Tensor:
    """Return planes (C, H, W) of the whole panorama from those of its two halves."""
    left, right = parts
    return torch.cat((left[..., :ROWS], torch.roll(right, -(ROWS // 2), dims=-1)[..., ROWS:]), dim=-1)


def test_equalized_colours_are_the_share_of_what_is_darker_in_all_images_together() -> None:
    rig, seen = two_halves()[1], textured().valid
    found = colors_of(rig)
    windows = found.pyramid.windows(ROWS)
    equalized = joined(windows.inside(found.equalized(windows))).numpy()
    elevation = np.pi / 2 - np.pi * (np.arange(ROWS) + 0.5) / ROWS
    weights = np.cos(elevation)[:, None].repeat(2 * ROWS, axis=1)[seen]
    for channel in range(3):
        values = textured().color[..., channel][seen].astype(int)
        histogram = np.bincount(values, weights, 256)
        darker = (np.cumsum(histogram) - histogram / 2) / histogram.sum()
        np.testing.assert_allclose(equalized[channel][seen], darker[values], atol=1e-3)


def test_the_contrast_of_a_panorama_is_that_of_its_sphere() -> None:
    panorama = textured()
    found = colors_of(Rig.of_panorama(panorama))
    windows = found.pyramid.windows(ROWS)
    (contrast,) = windows.inside(found.contrast(windows))
    color, valid = torch.from_numpy(panorama.color).float() / 255, torch.from_numpy(panorama.valid).float()
    expected = local_contrast((color * valid[..., None])[None], valid[None])[0].permute(2, 0, 1)
    torch.testing.assert_close(contrast, expected, atol=1e-4, rtol=0)
    assert float(contrast.std()) > 0.1


def test_images_of_a_rig_are_surrounded_by_each_other_as_parts_of_one_sphere() -> None:
    whole, parts = (colors_of(rig) for rig in two_halves())
    windows = whole.pyramid.windows(ROWS), parts.pyramid.windows(ROWS)
    (expected,) = windows[0].inside(whole.contrast(windows[0]))
    found = joined(windows[1].inside(parts.contrast(windows[1])))
    seen = torch.from_numpy(textured().valid)
    torch.testing.assert_close(found[:, seen], expected[:, seen], atol=2e-3, rtol=0)


def test_each_photo_is_held_against_its_own_surroundings() -> None:
    """A plain photo has no contrast, however bright the others are that look elsewhere."""
    here, behind = (Pose(rotation_of(yaw), np.zeros(3)) for yaw in (0.0, 180.0))
    found = colors_of(Rig((RigImage(plain(30), here), RigImage(plain(200), behind))))
    windows = found.pyramid.windows(ROWS)
    contrast = found.contrast(windows)
    for number in range(2):
        seen = (windows.valid > 0) & (windows.image == number)
        torch.testing.assert_close(contrast[:, seen], torch.full_like(contrast[:, seen], 0.5), atol=0.02, rtol=0)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_level_goes_from_equalized_colours_to_contrast(share: float) -> None:
    found = colors_of(two_halves()[1])
    windows = found.pyramid.windows(ROWS)
    expected = (1 - share) * found.equalized(windows) + share * found.contrast(windows)
    planes, seen = found.level(ROWS, share).planes, windows.valid > 0
    torch.testing.assert_close(planes[:3, seen], expected[:, seen], atol=1e-5, rtol=0)
    assert found.level(ROWS, share) is found.level(ROWS, share)
    # Finer than any image there is nothing more to see.
    assert found.level(4 * ROWS, share).rows == ROWS


def test_the_tables_of_a_comparison_take_the_place_of_those_of_all_that_images_show() -> None:
    found = colors_of(two_halves()[1])
    windows = found.pyramid.windows(ROWS)
    tables = torch.rand((3, 256), generator=torch.Generator().manual_seed(0))
    planes, seen = found.level_with(tables, ROWS, 0.25).planes, windows.valid > 0
    looked_up = [tables[channel][(255 * windows.color[channel]).round().long()] for channel in range(3)]
    expected = 0.75 * torch.stack(looked_up) + 0.25 * found.contrast(windows)
    torch.testing.assert_close(planes[:3, seen], expected[:, seen], atol=1e-5, rtol=0)


def test_codes_of_labels_are_canonical_as_they_are() -> None:
    labels = LabelCodes(torch.tensor([[0, 0, 0], [250, 20, 20]]), torch.tensor([[0.1, 0.2, 0.3], [0.9, 0.6, 0.4]]))
    photo = plain(0)
    photo.color[:, 200:] = (250, 20, 20)
    found = colors_of(Rig.of_photo(photo), labels)
    windows = found.pyramid.windows(256)
    seen = windows.valid > 0
    assert 0 < int((windows.color[0, seen] == 0.9).sum()) < int(seen.sum())
    for level in (found.level(256, 0.4), found.level_with(None, 256, 0.4)):
        assert torch.equal(level.planes[:3, seen], windows.color[:, seen])


def blurred_slowly(color: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return a panorama (3, H, W) averaged over valid neighbours with the weights 1 2 1, around its seam and over its poles."""
    _, height, width = color.shape
    total, mass = np.zeros_like(color), np.zeros_like(valid)
    for down, across in np.ndindex(3, 3):
        rows = np.arange(height) + down - 1
        beyond = (rows < 0) | (rows >= height)
        columns = (np.arange(width) + across - 1 + np.where(beyond, width // 2, 0)[:, None]) % width
        at = np.clip(rows, 0, height - 1)[:, None], columns
        weight = (1 + (down == 1)) * (1 + (across == 1)) * valid[at]
        total, mass = total + weight * color[:, *at], mass + weight
    return np.asarray(total / np.maximum(mass, 1))


def blurred_panorama() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what is found, what is expected (3, H, W), and which pixels are valid (H, W)."""
    found = colors_of(Rig.of_panorama(textured()))
    windows = found.pyramid.windows(ROWS)
    (sharp,) = windows.inside(found.equalized(windows))
    (blurred,) = windows.inside(found.level(ROWS, 0.0, blur=True).planes[:3])
    seen = windows.inside(windows.valid)[0].double().numpy()
    return blurred.numpy(), blurred_slowly(sharp.double().numpy(), seen), seen > 0


def test_a_blurred_level_averages_neighbours_that_are_valid() -> None:
    found, expected, seen = blurred_panorama()
    inner = np.zeros_like(seen)
    inner[1:-1, 1:-1] = True
    np.testing.assert_allclose(found[:, seen & inner], expected[:, seen & inner], atol=1e-5)


def test_a_blurred_panorama_goes_on_around_its_seam_and_over_its_poles() -> None:
    found, expected, seen = blurred_panorama()
    np.testing.assert_allclose(found[:, seen], expected[:, seen], atol=1e-5)
