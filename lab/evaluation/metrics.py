"""How well maps of what changed find it, how well scores separate, and how honest probabilities are."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.evaluation.known_cases import KnownQuery
from panoloc.lab.rooms.scenes.surface import load_open3d

Floats = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]


def change_metrics(query: KnownQuery, cloud: PointCloud, index: MapIndex, answer: Localization) -> dict[str, float]:
    """Return `ap_2d` and `ap_3d` of the answer's maps.

    Also `changed_pixels` and `changed_points`: the shares that did change, which is what a map without knowledge reaches. Compared are
    the pixels and points that the answer gives a score; figures that are not defined are left out.
    """
    found: dict[str, float] = {}
    if query.changed_pixels is not None and answer.score_map_2d is not None:
        height, width = answer.score_map_2d.shape
        changed = resampled(query.changed_pixels.astype(np.float32), height, width) >= 0.5
        seen = resampled(query.panorama.valid.astype(np.float32), height, width) > 0.99
        solid = np.broadcast_to(np.sin(np.pi * (np.arange(height) + 0.5) / height)[:, None], changed.shape)
        found |= _precision("ap_2d", "changed_pixels", answer.score_map_2d, changed, solid, seen)
    if query.changed_points is not None and answer.point_scores is not None:
        changed = points_of_index(query.changed_points, cloud.positions, index.positions.cpu().numpy())
        every = np.ones(len(changed))
        found |= _precision("ap_3d", "changed_points", answer.point_scores, changed, every, every > 0)
    return found


def _precision(
    name: str, of_share: str, scores: Floats, changed: Flags, weights: Floats, seen: Flags
) -> dict[str, float]:
    """Return the precision with which low scores find what changed, and the share that did; nothing where none of it has a score."""
    compared = np.isfinite(scores) & seen
    truth, weights = changed[compared], weights[compared]
    precision = average_precision(-scores[compared].astype(np.float64), truth, weights)
    if precision is None:
        return {}
    return {name: precision, of_share: float((weights * truth).sum() / weights.sum())}


def points_of_index(flags: Flags, positions: Floats, index_positions: Floats) -> Flags:
    """Return the flags (N,) of cloud points for the points (n,) of an index, which sorts and may thin them: the nearest point's."""
    o3d = load_open3d()
    search = o3d.core.nns.NearestNeighborSearch(o3d.core.Tensor.from_numpy(np.ascontiguousarray(positions)))
    search.knn_index()
    nearest, _ = search.knn_search(o3d.core.Tensor.from_numpy(np.ascontiguousarray(index_positions)), 1)
    return np.asarray(flags[nearest.numpy()[:, 0]], dtype=np.bool_)


def resampled(image: Floats, height: int, width: int) -> Floats:
    """Return (H, W) averaged over areas to (height, width)."""
    pooled = torch.nn.functional.adaptive_avg_pool2d(torch.from_numpy(image)[None, None], (height, width))
    return np.asarray(pooled[0, 0].numpy())


def average_precision(scores: Floats, positive: Flags, weights: Floats | None = None) -> float | None:
    """Return Σ (recall step · precision) over falling scores (N,), equal scores taken together; None without a positive.

    positive: (N,) bool. weights: (N,) >= 0, such as solid angles; None for equal ones.
    """
    ordered, true, false = _cumulated(scores, positive, weights)
    if len(ordered) == 0 or true[-1] == 0:
        return None
    precision = true / np.maximum(true + false, 1e-300)
    return float(np.sum(np.diff(true, prepend=0.0) * precision) / true[-1])


def area_under_roc(scores: Floats, positive: Flags) -> float | None:
    """Return the probability that a positive scores above a negative, ties counting half; None when one kind is missing."""
    ordered, true, false = _cumulated(scores, positive, None)
    if len(ordered) == 0 or true[-1] == 0 or false[-1] == 0:
        return None
    rate, fallout = np.append(0.0, true / true[-1]), np.append(0.0, false / false[-1])
    return float(np.sum(np.diff(fallout) * (rate[1:] + rate[:-1]) / 2))


def _cumulated(scores: Floats, positive: Flags, weights: Floats | None) -> tuple[Floats, Floats, Floats]:
    """Return the distinct scores, falling, with the weight of positives and of negatives at or above each."""
    order = np.argsort(-scores, kind="stable")
    falling = scores[order]
    weight = (np.ones(len(scores)) if weights is None else weights)[order]
    last_of_ties = np.append(np.diff(falling) != 0, True) if len(falling) else np.zeros(0, bool)
    true = np.cumsum(weight * positive[order])[last_of_ties]
    false = np.cumsum(weight * ~positive[order])[last_of_ties]
    return falling[last_of_ties], true, false


@dataclass(frozen=True)
class ReliabilityBin:
    """The answers whose probability lies in one bin: how many, their mean probability, and the share that was right."""

    lower: float
    upper: float
    count: int
    mean_probability: float
    share_right: float


def reliability_bins(probabilities: Floats, right: Flags, num_bins: int = 10) -> list[ReliabilityBin]:
    """Return the non-empty bins of equal width over 0..1."""
    number = np.clip((probabilities * num_bins).astype(int), 0, num_bins - 1)
    return [
        ReliabilityBin(
            k / num_bins,
            (k + 1) / num_bins,
            int((number == k).sum()),
            float(probabilities[number == k].mean()),
            float(right[number == k].mean()),
        )
        for k in range(num_bins)
        if (number == k).any()
    ]


def expected_calibration_error(probabilities: Floats, right: Flags) -> float | None:
    """Return the mean gap between probability and share right over bins of equal width, weighted by count; None without answers."""
    if len(probabilities) == 0:
        return None
    bins = reliability_bins(probabilities, right)
    return sum(b.count * abs(b.mean_probability - b.share_right) for b in bins) / len(probabilities)


def share_within(pairs: Iterable[tuple[float | None, float | None]]) -> float | None:
    """Return the share of errors within their radius, of those that have one; None without any."""
    held = [error <= radius for error, radius in pairs if error is not None and radius is not None]
    return sum(held) / len(held) if held else None
