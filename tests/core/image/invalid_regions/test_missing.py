"""What of a picture is missing, and what only looks like it: voids, bars and plain caps around the poles."""

import numpy as np
import pytest

from tests.core.image.invalid_regions.scenery import as_jpeg, find, scenery, shares

ROW, COLUMN = np.mgrid[:512, :1024]


def blob(row: float, column: float, radius: float) -> np.ndarray:
    """Return a region with a wavy outline."""
    angle = np.arctan2(ROW - row, COLUMN - column)
    return np.asarray(np.hypot(ROW - row, COLUMN - column) < radius * (1 + 0.2 * np.sin(7 * angle)))


@pytest.mark.parametrize("level", [(0, 0, 0), (255, 255, 255), (90, 90, 90), (20, 60, 230)], ids=str)
@pytest.mark.parametrize("quality", [70, 95])
def test_an_irregular_void_is_found_whatever_its_color(level: tuple[int, int, int], quality: int) -> None:
    covered = blob(200, 500, 130) | blob(480, 100, 90)
    color = np.where(covered[..., None], np.array(level), scenery()).astype(np.uint8)
    found = find(as_jpeg(color, quality))
    share, lost = shares(found, covered)
    assert share > 0.95
    assert lost < 0.03
    assert len(found.words) == 1
    assert "void" in found.words[0]


def test_a_void_over_the_seam_is_found() -> None:
    covered = blob(200, 0, 100) | blob(200, 1023, 100)
    color = np.where(covered[..., None], 0, scenery()).astype(np.uint8)
    assert shares(find(as_jpeg(color)), covered)[0] > 0.97


@pytest.mark.slow
def test_a_void_is_found_in_a_large_image() -> None:
    covered = blob(200, 500, 130).repeat(3, axis=0).repeat(3, axis=1)
    color = np.where(covered[..., None], 0, scenery(3072, 1536)).astype(np.uint8)
    found = find(color)
    assert found.missing.shape == (1536, 3072)
    assert shares(found, covered)[0] > 0.97
    assert shares(found, covered)[1] < 0.03


def test_a_black_wall_is_not_a_missing_pixel() -> None:
    # A dark wall in a dim corner: its light fades into the rest, and the camera's noise is on it.
    dark = np.clip(np.abs(COLUMN - 512) / 2.0 - 60, 0, 255)[..., None]
    color = np.clip(np.minimum(scenery(), dark) + np.random.default_rng(0).normal(0, 1.5, (512, 1024, 3)), 0, 255)
    assert not find(as_jpeg(color.astype(np.uint8))).missing.any()


def test_an_overexposed_wall_is_not_a_missing_pixel() -> None:
    light = np.clip(330 - np.abs(COLUMN - 512) / 2.0, 0, 255)[..., None] * np.array([1.0, 0.97, 0.9])
    color = np.clip(np.maximum(scenery(), light) * 1.2, 0, 255).astype(np.uint8)
    assert (color.min(axis=-1) == 255).mean() > 0.1
    assert not find(as_jpeg(color)).missing.any()


def test_a_lamp_that_one_channel_clips_before_the_others_is_not_a_missing_pixel() -> None:
    # A hard edge of clipped white: around it the warm light still clips the red.
    lamp = np.hypot(ROW - 150, COLUMN - 500)
    color = scenery()
    color[lamp < 110] = (255, 225, 150)
    color[lamp < 90] = 255
    assert not find(as_jpeg(color)).missing.any()


@pytest.mark.parametrize("quality", [70, 85, 95])
def test_a_white_ceiling_with_the_noise_of_a_camera_is_not_a_missing_pixel(quality: int) -> None:
    color = scenery().astype(np.float64)
    color[:150] = 251 + np.random.default_rng(1).normal(0, 2, (150, 1024, 3))
    assert not find(as_jpeg(np.clip(color, 0, 255).astype(np.uint8), quality)).missing.any()


def test_flat_walls_of_a_rendering_without_noise_stay() -> None:
    color = np.full((512, 1024, 3), (226, 222, 213), np.uint8)
    color[180:330], color[330:] = (240, 246, 242), (160, 160, 160)
    for at, wall in enumerate(((200, 90, 60), (60, 90, 140), (30, 30, 30), (255, 255, 255))):
        color[200:320, 100 + 200 * at : 220 + 200 * at] = wall
    assert not find(color).missing.any()


def test_a_small_blown_window_stays_or_costs_little() -> None:
    color = scenery()
    color[150:250, 300:380] = 255
    assert find(as_jpeg(color)).missing.mean() < 0.03


def test_a_picture_of_little_but_one_color_keeps_it() -> None:
    color = np.full((512, 1024, 3), 128, np.uint8)
    color[200:300, 400:500] = scenery()[200:300, 400:500]
    assert not find(color).missing.any()


@pytest.mark.parametrize("share_of_one", [0.1, 0.7])
def test_labels_are_left_alone(share_of_one: float) -> None:
    codes = np.random.default_rng(0).integers(0, 255, (12, 3)).astype(np.uint8)
    codes[0] = 0
    classes = np.random.default_rng(1).integers(0, 12, (8, 16)).repeat(64, axis=0).repeat(64, axis=1)
    classes[: int(512 * share_of_one)] = 3
    classes[-60:] = 0
    assert not find(codes[classes]).missing.any()


def test_a_small_thing_of_one_color_is_not_a_missing_pixel() -> None:
    color = scenery()
    color[300:380, 200:450] = (90, 130, 60)  # 4 % of the image
    assert not find(as_jpeg(color)).missing.any()


def test_a_photo_has_no_seam_and_its_share_is_of_its_pixels() -> None:
    color = scenery(640, 480)
    color[:200, :300] = 0
    found = find(as_jpeg(color), is_sphere=False)
    assert found.words == ("20% of the photo is a flat black void and was left out; send a mask to override this",)


# Bars.


@pytest.mark.parametrize("level", [(0, 0, 0), (255, 255, 255), (128, 128, 128), (15, 60, 200)], ids=str)
@pytest.mark.parametrize("quality", [70, 95])
@pytest.mark.parametrize("sides", ["above or below", "left or right"])
@pytest.mark.parametrize("is_sphere", [True, False], ids=["panorama", "photo"])
def test_bars_of_any_color_are_found(level: tuple[int, int, int], quality: int, sides: str, is_sphere: bool) -> None:
    color = scenery(1024, 512) if is_sphere else scenery(480, 360)
    covered = np.zeros(color.shape[:2], np.bool_)
    view = covered if sides == "above or below" else covered.T
    view[:51], view[-37:] = True, True
    color[covered] = level
    found = find(as_jpeg(color, quality), is_sphere)
    share, lost = shares(found, covered)
    assert share > 0.95  # ripples of JPEG beside the edge may stay
    assert lost < 0.03
    assert len(found.words) == 1


# Poles.


@pytest.mark.parametrize("pole", ["top", "bottom"])
@pytest.mark.parametrize("level", [(0, 0, 0), (255, 255, 255), (60, 60, 70)], ids=str)
def test_a_plain_cap_is_found_to_its_rim(level: tuple[int, int, int], pole: str) -> None:
    rows = 70  # 25 degrees from the pole
    color = scenery()
    from_pole = color if pole == "top" else color[::-1]
    from_pole[:rows] = level
    found = find(as_jpeg(color, 90))
    missing = found.missing if pole == "top" else found.missing[::-1]
    assert missing[: rows - 1].all()
    assert not missing[rows + 4 :].any()
    assert len(found.words) == 1


@pytest.mark.parametrize("seed", range(4))
def test_scenery_has_no_void(seed: int) -> None:
    assert find(as_jpeg(scenery(seed=seed), 80)).words == ()
