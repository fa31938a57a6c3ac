"""The judge's measures against loops over their definitions."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.judge.agreement import Agreement, agreement
from tests.reference import judge_twin as twin

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
            "correlation": twin.correlation(scan, panorama, weights),
            "patch_correlation": twin.patch_correlation(scan, panorama, weights, HEIGHT, HEIGHT // ROWS),
            "mutual_information": twin.mutual_information(scan, panorama, weights),
            "inlier_share": twin.inlier_share(scan, panorama, weights),
            "coverage": weights.sum() / (4 * math.pi),
        }
        both = expected["correlation"] + expected["patch_correlation"]
        expected["score"] = both * math.sqrt(expected["coverage"])
        for name, value in expected.items():
            assert float(getattr(found, name)[k]) == pytest.approx(value, rel=1e-4, abs=1e-6), name
