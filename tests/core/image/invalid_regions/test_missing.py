"""What of a picture is missing, and what only looks like it: voids, bars, and what cameras and stitchers put around the poles."""

import numpy as np
import pytest
from PIL import Image, ImageFilter

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


def test_a_void_over_the_seam_is_one_piece() -> None:
    covered = blob(200, 0, 100) | blob(200, 1023, 100)
    color = np.where(covered[..., None], 0, scenery()).astype(np.uint8)
    assert shares(find(as_jpeg(color)), covered)[0] > 0.97


@pytest.mark.slow
def test_a_void_is_found_in_an_image_larger_than_what_is_looked_at() -> None:
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


def test_labels_are_left_alone() -> None:
    codes = np.random.default_rng(0).integers(0, 255, (12, 3)).astype(np.uint8)
    codes[0] = 0
    color = codes[np.random.default_rng(1).integers(0, 12, (8, 16))].repeat(64, axis=0).repeat(64, axis=1)
    color[:120] = 0
    assert not find(color).missing.any()


def test_a_photo_has_no_seam_and_its_share_is_of_its_pixels() -> None:
    color = scenery(640, 480)
    color[:200, :300] = 0
    found = find(as_jpeg(color), is_sphere=False)
    assert found.words == ("20% of the photo is a flat black void and was left out; send a mask to override this",)


# Bars.


@pytest.mark.parametrize("level", [(0, 0, 0), (255, 255, 255), (128, 128, 128), (15, 60, 200)], ids=str)
@pytest.mark.parametrize("quality", [70, 80, 95])
@pytest.mark.parametrize("sides", ["above or below", "left or right"])
@pytest.mark.parametrize("is_sphere", [True, False], ids=["panorama", "photo"])
def test_bars_of_any_color_are_found_to_their_edges(
    level: tuple[int, int, int], quality: int, sides: str, is_sphere: bool
) -> None:
    color = scenery(1024, 512) if is_sphere else scenery(480, 360)
    covered = np.zeros(color.shape[:2], np.bool_)
    view = covered if sides == "above or below" else covered.T
    view[:51], view[-37:] = True, True
    color[covered] = level
    found = find(as_jpeg(color, quality), is_sphere)
    share, lost = shares(found, covered)
    assert share > 0.999
    assert lost < 0.03
    assert len(found.words) == 1
    assert sides in found.words[0]


def test_a_flat_ceiling_is_no_bar() -> None:
    # Its rim runs up and down as the rim of every room does that is not round.
    rim = 120 + 60 * np.abs(np.sin(np.arange(1024) / 1024 * 2 * np.pi * 2))
    ceiling = np.arange(512)[:, None] < rim
    color = np.where(ceiling[..., None], np.array([226, 222, 213]), scenery(noise=0)).astype(np.uint8)
    assert not any("bar" in words for words in find(color).words)


# Poles.

ROWS = 70  # of a cap, 25 degrees from the pole


@pytest.mark.parametrize("pole", ["top", "bottom"])
@pytest.mark.parametrize("kind", ["patch", "mirrored", "blurred"])
def test_a_cap_is_found_to_its_rim_and_named(kind: str, pole: str) -> None:
    color = scenery()
    from_pole = color if pole == "top" else color[::-1]
    if kind == "patch":
        from_pole[:ROWS] = (30, 30, 40)
        from_pole[20:50, 200:420] = (220, 40, 30)
        from_pole[30:40, 600:900] = 250
    elif kind == "mirrored":
        from_pole[:ROWS] = from_pole[ROWS : 2 * ROWS][::-1]
    else:
        from_pole[:ROWS] = np.asarray(Image.fromarray(from_pole).filter(ImageFilter.GaussianBlur(12)))[:ROWS]
    found = find(as_jpeg(color, 90))
    missing = found.missing if pole == "top" else found.missing[::-1]
    assert missing[: ROWS - 6].all()
    assert not missing[ROWS + 8 :].any()
    assert len(found.words) == 1
    assert kind in found.words[0]
    assert f"{pole} pole" in found.words[0]


@pytest.mark.parametrize("seed", range(4))
def test_scenery_has_nothing_around_its_poles(seed: int) -> None:
    assert find(as_jpeg(scenery(seed=seed), 80)).words == ()


def test_walls_whose_edges_run_up_and_down_are_no_mirror() -> None:
    stripes = np.broadcast_to((np.arange(1024) // 32 % 2 * 90 + 80)[None, :, None], (512, 1024, 3))
    color = np.clip(stripes + np.random.default_rng(0).normal(0, 2, (512, 1024, 3)), 0, 255).astype(np.uint8)
    assert find(as_jpeg(color)).words == ()


def test_a_photo_has_no_poles() -> None:
    color = scenery(640, 480)
    color[-80:] = color[-160:-80][::-1]
    assert find(as_jpeg(color), is_sphere=False).words == ()
