"""The picture of a scan from above, and where positions are in it."""

import numpy as np

from panoloc.core.scan.from_above import Area, draw_from_above


def test_pixels_of_positions_are_those_that_are_drawn() -> None:
    positions = np.array([[0.0, 0.0, 0.0], [4.0, 2.0, 0.0], [4.0, 2.0, 9.0]])
    colors = np.array([[255, 0, 0], [0, 0, 255], [0, 0, 0]], np.uint8)
    seen = draw_from_above(positions, colors, Area(np.array([-1.0, -1]), np.array([5.0, 3]), top_m=1.0), 600)
    assert seen.picture.shape == (400, 600, 3)
    assert seen.pixels_per_m == 100
    for position, color in zip(positions[:2], colors[:2], strict=True):
        ((column, row),) = seen.pixels_of(position[None])
        assert np.array_equal(seen.picture[row, column], color)


def test_small_gaps_between_points_are_closed_and_what_lies_outside_stays_empty() -> None:
    side = np.arange(0.0, 4.0, 0.1)
    floor = np.stack([*np.meshgrid(side, side), np.zeros((40, 40))], axis=-1).reshape(-1, 3) + 0.05
    thinned = floor[np.random.default_rng(0).random(len(floor)) < 0.8]
    colors = np.full((len(thinned), 3), (200, 60, 20), np.uint8)
    seen = draw_from_above(thinned, colors, Area(np.zeros(2), np.array([8.0, 4.0]), top_m=1.0), 160)
    is_floor = (seen.picture == (200, 60, 20)).all(-1)
    assert is_floor[:, :80].mean() > 0.99  # of 0.8 that points fell on
    assert is_floor[:, 80:].sum() == 0
