"""How well maps of what changed find what did: average precision per pixel and per point."""

import numpy as np
import open3d as o3d
import torch
from numpy.typing import NDArray

from panoloc.core.index.map_index import MapIndex
from panoloc.core.results import Localization
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.evaluation.known_cases import KnownQuery
from panoloc.lab.evaluation.ranking_metrics import average_precision

Flags = NDArray[np.bool_]
Floats = NDArray[np.float32]


def change_metrics(query: KnownQuery, cloud: PointCloud, index: MapIndex, answer: Localization) -> dict[str, float]:
    """Return `ap_2d` and `ap_3d` of the answer's maps.

    Also `changed_pixels` and `changed_points`: the shares that did change, which is what a map without knowledge reaches. Compared are
    the pixels and points that the answer gives a score; figures that are not defined are left out.
    """
    values: dict[str, float | None] = {}
    if query.changed_pixels is not None and answer.score_map_2d is not None:
        values |= _pixel_metrics(answer.score_map_2d, query)
    if query.changed_points is not None and answer.point_scores is not None:
        changed = points_of_index(query.changed_points, cloud.positions, index.positions.cpu().numpy())
        values |= _point_metrics(answer.point_scores, changed)
    return {name: value for name, value in values.items() if value is not None}


def _pixel_metrics(scores: Floats, query: KnownQuery) -> dict[str, float | None]:
    assert query.changed_pixels is not None
    height, width = scores.shape
    changed = resampled(query.changed_pixels.astype(np.float32), height, width) >= 0.5
    compared = np.isfinite(scores) & (resampled(query.panorama.valid.astype(np.float32), height, width) > 0.99)
    sines = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    solid = np.broadcast_to(sines[:, None], scores.shape)[compared]
    truth = changed[compared]
    values: dict[str, float | None] = {"ap_2d": average_precision(-scores[compared].astype(np.float64), truth, solid)}
    if truth.any():
        values["changed_pixels"] = float((solid * truth).sum() / solid.sum())
    return values


def _point_metrics(scores: Floats, changed: Flags) -> dict[str, float | None]:
    compared = np.isfinite(scores)
    truth = changed[compared]
    values: dict[str, float | None] = {"ap_3d": average_precision(-scores[compared].astype(np.float64), truth)}
    if truth.any():
        values["changed_points"] = float(truth.mean())
    return values


def points_of_index(flags: Flags, positions: Floats, index_positions: Floats) -> Flags:
    """Return the flags (N,) of cloud points for the points (n,) of an index, which sorts and may thin them: the nearest point's."""
    search = o3d.core.nns.NearestNeighborSearch(o3d.core.Tensor.from_numpy(np.ascontiguousarray(positions)))
    search.knn_index()
    nearest, _ = search.knn_search(o3d.core.Tensor.from_numpy(np.ascontiguousarray(index_positions)), 1)
    return np.asarray(flags[nearest.numpy()[:, 0]], dtype=np.bool_)


def resampled(image: Floats, height: int, width: int) -> Floats:
    """Return (H, W) averaged over areas to (height, width)."""
    pooled = torch.nn.functional.adaptive_avg_pool2d(torch.from_numpy(image)[None, None], (height, width))
    return np.asarray(pooled[0, 0].numpy())
