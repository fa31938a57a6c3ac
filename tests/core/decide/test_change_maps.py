"""What changed, on images in which it is known."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.config import ChangeConfig
from panoloc.core.decide.change_maps import ChangeMaps, change_maps
from panoloc.core.geometry.projection import pixel_directions, pixel_solid_angles
from panoloc.core.geometry.rotations import even_directions, rotation_from_vector
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.synthetic_view import SyntheticViews

HEIGHT, WIDTH = 24, 48
SOLID = pixel_solid_angles(HEIGHT, WIDTH).expand(-1, WIDTH)
CENTER = torch.tensor([1.0, -2.0, 0.5])
BLOCK = slice(8, 16), slice(10, 22)
CONFIG = ChangeConfig(half_score_difference=0.2, sampled_points=50_000)


def picture() -> torch.Tensor:
    """Return smooth colours (H, W, 3) in 0..1."""
    x, y, z = pixel_directions(HEIGHT, WIDTH).unbind(-1)
    return 0.5 + 0.4 * torch.stack((x, y * z, (x * y + z) / 1.5), dim=-1)


def with_block(image: torch.Tensor) -> torch.Tensor:
    """Return the picture with something else in the block."""
    changed = image.clone()
    changed[BLOCK] = torch.tensor([1.6, -0.6, 1.6])
    return changed


def compared(
    scan: torch.Tensor,
    panorama: torch.Tensor,
    weights: torch.Tensor = SOLID,
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
    config: ChangeConfig = CONFIG,
) -> ChangeMaps:
    """Compare both in map axes, on points 2 m around the camera and others behind them."""
    depth = torch.full((1, HEIGHT, WIDTH), 2.0)
    none, axes = torch.zeros_like(depth, dtype=torch.int64), torch.eye(3)[None]
    views = SyntheticViews(scan[None], depth, depth > 0, none, SphereWindow.of_sphere(HEIGHT), axes)
    sides = scan.flatten(0, 1)[None], panorama.flatten(0, 1)[None], weights.flatten()[None]
    comparison = Comparison(*sides, None, views, torch.zeros_like(sides[2], dtype=torch.int64))
    near = even_directions(3000)
    # In the order of a curve, neighbours are together; here every other point is hidden.
    positions = CENTER + torch.stack((2 * near, 5 * near), dim=1).flatten(0, 1)
    cloud: Any = SimpleNamespace(positions=positions, spacing=0.02)
    return change_maps(comparison, cloud, rotation_from_vector(torch.tensor(turn)), CENTER, config)


def test_points_have_the_score_of_the_pixel_that_shows_them() -> None:
    found = compared(picture(), with_block(picture()))
    scores = found.point_scores()[0::2]
    directions = even_directions(3000)
    azimuth, elevation = torch.atan2(directions[:, 1], directions[:, 0]), torch.asin(directions[:, 2])
    column = ((math.pi - azimuth) / (2 * math.pi) * WIDTH).long().clamp(0, WIDTH - 1)
    row = ((math.pi / 2 - elevation) / math.pi * HEIGHT).long().clamp(0, HEIGHT - 1)
    # Without a turn the map's pixels are the panorama's.
    expected = found.score_map_2d()[row.numpy(), column.numpy()]
    assert np.mean(np.abs(scores - expected) < 1e-4) > 0.98
    changed = float(np.mean(scores < 0.5))
    assert found.map_changed_fraction == pytest.approx(changed, abs=1e-6)


def test_what_either_side_does_not_show_is_unknown_and_has_no_share() -> None:
    weights = SOLID.clone()
    weights[:, :24] = 0
    found = compared(picture(), with_block(picture()), weights)
    assert np.isnan(found.score_map_2d()[:, 1:23]).all()
    assert not np.isnan(found.score_map_2d()[:, 25:47]).any()
    assert found.panorama_changed_fraction == pytest.approx(0, abs=0.01)
    assert np.isnan(found.point_scores()).sum() > 3000 + 1400


def neighbours(row: int, column: int, height: int, width: int) -> list[tuple[int, int]]:
    """Return the 3 x 3 pixels around one; over a pole the image goes on on the opposite meridian."""
    found = []
    for r in (row - 1, row, row + 1):
        for c in (column - 1, column, column + 1):
            if r < 0:
                found.append((-1 - r, (c + width // 2) % width))
            elif r >= height:
                found.append((2 * height - 1 - r, (c + width // 2) % width))
            else:
                found.append((r, c % width))
    return found


def fitted_light(panorama: np.ndarray, scan: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the panorama (S, 3) with the gain and offset per channel that bring it nearest to the scan."""
    share = weights / weights.sum()
    fitted = np.zeros_like(panorama)
    for channel in range(3):
        source, target = panorama[:, channel], scan[:, channel]
        middle, wanted = share @ source, share @ target
        slope = (share @ ((source - middle) * (target - wanted)) + 1e-3) / (share @ (source - middle) ** 2 + 1e-3)
        fitted[:, channel] = (source - middle) * np.clip(slope, 1 / 3, 3.0) + wanted
    return fitted


def pixel_scores(scan: np.ndarray, panorama: np.ndarray, weights: np.ndarray, half: float) -> np.ndarray:
    """Return scores (H, W) of images (H, W, 3) with weights (H, W); a colour distance of `half` to the best pixel nearby scores 0.5."""
    height, width, _ = scan.shape
    robust = weights.ravel()
    for _ in range(3):
        fitted = fitted_light(panorama.reshape(-1, 3), scan.reshape(-1, 3), robust)
        distance = np.linalg.norm(fitted - scan.reshape(-1, 3), axis=1) / half
        robust = weights.ravel() / (1 + distance**2) ** 2
    nearby = fitted.reshape(scan.shape)
    sharp = np.zeros((height, width))
    for row, column in np.ndindex(height, width):
        distances = [np.linalg.norm(nearby[p] - scan[row, column]) for p in neighbours(row, column, height, width)]
        sharp[row, column] = 1 / (1 + (min(distances) / half) ** 2)
    scores = np.zeros((height, width))
    for row, column in np.ndindex(height, width):
        scores[row, column] = np.mean([sharp[p] for p in neighbours(row, column, height, width)])
    return scores


def test_scores_and_shares_are_those_of_a_loop_over_the_pixels() -> None:
    rng = np.random.default_rng(0)
    scan = picture().double().numpy()
    panorama = with_block(picture()).double().numpy() * 0.8 + rng.normal(0, 0.15, scan.shape)
    weights = SOLID.double().numpy() * (rng.uniform(size=(HEIGHT, WIDTH)) > 0.1)
    for config in (CONFIG, ChangeConfig(half_score_difference=0.3)):
        first, second, third = (torch.from_numpy(each).float() for each in (scan, panorama, weights))
        found = compared(first, second, third, config=config)
        expected = pixel_scores(scan, panorama, weights, config.half_score_difference)
        seen = weights > 0
        np.testing.assert_allclose(found.score_map_2d()[seen], expected[seen], atol=1e-4)
        changed = weights[expected < 0.5].sum() / weights.sum()
        assert 0.02 < changed < 0.98
        assert found.panorama_changed_fraction == pytest.approx(changed, abs=0.003)


def test_where_no_point_is_seen_none_has_changed() -> None:
    found = compared(picture(), with_block(picture()), torch.zeros_like(SOLID))
    assert found.map_changed_fraction == 0.0
    assert np.isnan(found.point_scores()).all()
    assert np.isnan(found.score_map_2d()).all()


def test_the_map_is_shown_in_the_panorama_s_own_pixels() -> None:
    level = compared(picture(), with_block(picture())).score_map_2d()
    turned = compared(picture(), with_block(picture()), turn=(0.0, 0.0, math.pi / 2)).score_map_2d()
    # A camera turned to the left by a quarter sees what was at its left in the middle.
    np.testing.assert_allclose(turned, np.roll(level, WIDTH // 4, axis=1), atol=1e-3)
    above = compared(picture(), with_block(picture()), turn=(math.pi, 0.0, 0.0)).score_map_2d()
    np.testing.assert_allclose(above, level[::-1, ::-1], atol=1e-3)
