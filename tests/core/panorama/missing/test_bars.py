"""Letter boxes and missing sides."""

import numpy as np
import pytest

from tests.core.panorama.missing.scenery import as_jpeg, find, scenery, shares


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
