"""The judge's measures against loops over their definitions."""

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.agreement import Agreement, agreement
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.sphere_window import SphereWindow

Array = NDArray[np.float64]


def covariances(first: Array, second: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Return the weighted covariance and both variances (C,) of colours (S, C) with weights (S,)."""
    share = weights / weights.sum()
    moments = np.zeros((3, first.shape[1]))
    middle_first, middle_second = share @ first, share @ second
    for one, other, part in zip(first, second, share, strict=True):
        a, b = one - middle_first, other - middle_second
        moments += part * np.stack((a * b, a * a, b * b))
    return moments[0], moments[1], moments[2]


def correlation(scan: Array, seen: Array, weights: Array) -> float:
    """Return the mean over channels of the correlation of all pixels, with 1e-3 for the variance of noise."""
    both, one, other = covariances(scan, seen, weights)
    return float(np.mean(both / np.sqrt((one + 1e-3) * (other + 1e-3))))


def in_patches(scan: Array, seen: Array, weights: Array, height: int, side: int) -> list[tuple[float, float]]:
    """Return the correlation of all channels together inside each patch, and its share of all.

    Patches are `side` pixels high and wide; half of the shares are those of patches that begin in the middle of others. height: of the
    image. 1e-3 stands for the variance of noise.
    """
    width, found = 2 * height, []
    for begin in (0, -(side // 2)):
        for top, left in itertools.product(range(begin, height, side), range(begin, width, side)):
            rows, columns = (range(max(first, 0), first + side) for first in (top, left))
            inside = [row * width + column for row in rows for column in columns if row < height and column < width]
            mass = weights[inside].sum()
            if mass > 0:
                both, one, other = (part.sum() for part in covariances(scan[inside], seen[inside], weights[inside]))
                found.append((both / math.sqrt((one + 1e-3) * (other + 1e-3)), mass / weights.sum() / 2))
    return found


HEIGHT = 16
SHARES = (0.7, 0.9, 0.3)  # of the sphere, that were photographed
COUNT = HEIGHT * 2 * HEIGHT


def made_pairs() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scans and what images show (3, S, 3) that have something in common, and weights (3, S), whole patches of them zero."""
    rng = np.random.default_rng(0)
    scan = rng.uniform(size=(3, COUNT, 3))
    seen = np.clip(np.array([0.8, 0.3, 0.5])[:, None, None] * scan + 0.4 * rng.uniform(size=scan.shape), 0, 1)
    solid = pixel_solid_angles(HEIGHT, 2 * HEIGHT).expand(-1, 2 * HEIGHT).flatten().double().numpy()
    weights = solid * (rng.uniform(size=(3, COUNT)) < np.array([1.0, 0.7, 0.5])[:, None])
    weights[1].reshape(HEIGHT, 2 * HEIGHT)[:8, :20] = 0
    scan[2, :40] = 1.0  # the last step of brightness has an upper end
    return scan, seen, weights


def measured(*pairs: np.ndarray, side: int = 4, lines: torch.Tensor | None = None) -> Agreement:
    sides = {
        name: torch.from_numpy(each).float() for name, each in zip(("scan", "seen", "weights"), pairs, strict=True)
    }
    comparison: Any = SimpleNamespace(**sides, views=SimpleNamespace(window=SphereWindow.of_sphere(HEIGHT)))
    return agreement(comparison, JudgeConfig(), torch.tensor(SHARES), 180 * side / HEIGHT, lines)


@pytest.mark.parametrize("side", [4, 5], ids=["whole patches", "patches cut by the border"])
def test_every_measure_agrees_with_its_definition_and_so_does_the_score(side: int) -> None:
    pairs = made_pairs()
    found = measured(*pairs, side=side)
    for k, (scan, seen, weights) in enumerate(zip(*pairs, strict=True)):
        inside = in_patches(scan, seen, weights, HEIGHT, side)
        expected = {
            "correlation": correlation(scan, seen, weights),
            "patch_correlation": sum(share * value for value, share in inside),
            "coverage": weights.sum() / (4 * math.pi),
            "explained": sum(share * (1 - math.sqrt(1 - max(value, 0) ** 2)) for value, share in inside),
        }
        expected["relative_coverage"] = min(1.0, expected["coverage"] / SHARES[k])
        expected["score"] = 2 * expected["explained"] * math.sqrt(expected["relative_coverage"])
        for name, value in expected.items():
            assert float(getattr(found, name)[k]) == pytest.approx(value, rel=1e-4, abs=1e-6), name


def test_where_lines_disagree_the_score_is_less_by_their_share() -> None:
    without, lines = measured(*made_pairs()).score, torch.tensor([1.0, 0.4, 0.0])
    expected = [1.0, 1 - 0.6 * JudgeConfig().lines_share, 1 - JudgeConfig().lines_share]
    assert (measured(*made_pairs(), lines=lines).score / without).tolist() == pytest.approx(expected)
