"""What cameras and stitchers put around the poles."""

import numpy as np
import pytest
from PIL import Image, ImageFilter

from tests.core.panorama.missing.scenery import as_jpeg, find, scenery

ROWS = 70  # of the cap, 25 degrees from the pole


def capped(cap: np.ndarray, pole: str) -> np.ndarray:
    """Return the scenery with a cap (rows from the pole outwards) around a pole, compressed."""
    color = scenery()
    (color if pole == "top" else color[::-1])[:ROWS] = cap
    return as_jpeg(color, 90)


def outwards(pole: str) -> np.ndarray:
    return scenery() if pole == "top" else scenery()[::-1]


def disc() -> np.ndarray:
    cap = np.full((ROWS, 1024, 3), (30, 30, 40), np.uint8)
    cap[20:50, 200:420] = (220, 40, 30)
    cap[30:40, 600:900] = 250
    return cap


@pytest.mark.parametrize("pole", ["top", "bottom"])
@pytest.mark.parametrize("kind", ["patch", "mirrored", "blurred"])
def test_a_cap_is_found_to_its_rim_and_named(kind: str, pole: str) -> None:
    around = outwards(pole)
    smooth = np.asarray(Image.fromarray(around).filter(ImageFilter.GaussianBlur(12)))
    cap = {"patch": disc(), "mirrored": around[ROWS : 2 * ROWS][::-1], "blurred": smooth[:ROWS]}[kind]
    found = find(capped(cap, pole))
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
