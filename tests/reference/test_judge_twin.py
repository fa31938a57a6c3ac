"""The judge's measures against loops over their definitions."""

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


def correlation(scan: Array, panorama: Array, weights: Array) -> float:
    """Return the mean over channels of the correlation of all pixels, with 1e-4 for the variance of noise."""
    both, one, other = covariances(scan, panorama, weights)
    return float(np.mean(both / np.sqrt((one + 1e-4) * (other + 1e-4))))


def patch_correlation(scan: Array, panorama: Array, weights: Array, height: int, rows: int) -> float:
    """Return the mean over patches of the correlation of all their channels together, by the weight that each patch has.

    height: of the image; rows: of patches. 1e-3 stands for the variance of noise.
    """
    side, width = height // rows, 2 * height
    total = 0.0
    for top in range(0, height, side):
        for left in range(0, width, side):
            inside = [row * width + column for row in range(top, top + side) for column in range(left, left + side)]
            mass = weights[inside].sum()
            if mass > 0:
                both, one, other = (part.sum() for part in covariances(scan[inside], panorama[inside], weights[inside]))
                total += mass * both / math.sqrt((one + 1e-3) * (other + 1e-3))
    return float(total / weights.sum())


def mutual_information(scan: Array, panorama: Array, weights: Array) -> float:
    """Return the mutual information in nats of the brightness of both, each in 16 steps."""
    joint = np.zeros((16, 16))
    for one, other, weight in zip(scan.mean(1), panorama.mean(1), weights / weights.sum(), strict=True):
        joint[min(int(one * 16), 15), min(int(other * 16), 15)] += weight
    information = 0.0
    for a, b in np.argwhere(joint > 0):
        information += joint[a, b] * math.log(joint[a, b] / (joint[a].sum() * joint[:, b].sum()))
    return information


def inlier_share(scan: Array, panorama: Array, weights: Array) -> float:
    """Return the share of pixels that fit; one whose colours are 0.15 apart counts half."""
    fits = [1 / (1 + ((a - b) @ (a - b)) / 0.15**2) for a, b in zip(scan, panorama, strict=True)]
    return float(weights @ np.array(fits) / weights.sum())


HEIGHT, ROWS = 16, 4
COUNT = HEIGHT * 2 * HEIGHT


def made_pairs() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return scans and panoramas (3, S, 3) that have something in common, and weights (3, S), whole patches of them zero."""
    rng = np.random.default_rng(0)
    scan = rng.uniform(size=(3, COUNT, 3))
    panorama = np.clip(np.array([0.8, 0.3, 0.5])[:, None, None] * scan + 0.4 * rng.uniform(size=scan.shape), 0, 1)
    solid = pixel_solid_angles(HEIGHT, 2 * HEIGHT).expand(-1, 2 * HEIGHT).flatten().double().numpy()
    weights = solid * (rng.uniform(size=(3, COUNT)) < np.array([1.0, 0.7, 0.5])[:, None])
    weights[1].reshape(HEIGHT, 2 * HEIGHT)[:8, :20] = 0
    scan[2, :40] = 1.0  # the last step of brightness has an upper end
    return scan, panorama, weights


def measured(scan: np.ndarray, panorama: np.ndarray, weights: np.ndarray) -> Agreement:
    names = ("scan", "panorama", "weights")
    sides = {name: torch.from_numpy(each).float() for name, each in zip(names, (scan, panorama, weights), strict=True)}
    comparison: Any = SimpleNamespace(**sides, views=SimpleNamespace(window=SphereWindow.of_sphere(HEIGHT)))
    return agreement(comparison, JudgeConfig(patch_rows=ROWS))


def test_every_measure_agrees_with_its_definition_and_so_does_the_score() -> None:
    pairs = made_pairs()
    found = measured(*pairs)
    for k, (scan, panorama, weights) in enumerate(zip(*pairs, strict=True)):
        expected = {
            "correlation": correlation(scan, panorama, weights),
            "patch_correlation": patch_correlation(scan, panorama, weights, HEIGHT, HEIGHT // ROWS),
            "mutual_information": mutual_information(scan, panorama, weights),
            "inlier_share": inlier_share(scan, panorama, weights),
            "coverage": weights.sum() / (4 * math.pi),
        }
        both = expected["correlation"] + expected["patch_correlation"]
        expected["score"] = both * math.sqrt(expected["coverage"])
        for name, value in expected.items():
            assert float(getattr(found, name)[k]) == pytest.approx(value, rel=1e-4, abs=1e-6), name
