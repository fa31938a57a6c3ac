"""The picture of a scan from above, and where positions are in it."""

import numpy as np

from core.scan.from_above import Area, draw_from_above


def test_pixels_of_positions_are_those_that_are_drawn() -> None:
    positions = np.array([[0.0, 0.0, 0.0], [4.0, 2.0, 0.0], [4.0, 2.0, 9.0]])
    colors = np.array([[255, 0, 0], [0, 0, 255], [0, 0, 0]], np.uint8)
    seen = draw_from_above(positions, colors, Area(np.array([-1.0, -1]), np.array([5.0, 3]), top_m=1.0), 600)
    assert seen.picture.shape == (400, 600, 3)
    assert seen.pixels_per_m == 100
    for position, color in zip(positions[:2], colors[:2], strict=True):
        ((column, row),) = seen.pixels_of(position[None])
        assert np.array_equal(seen.picture[row, column], color)
