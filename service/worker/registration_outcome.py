"""What a registration tells of a map besides its index: figures, the starts, and a sample of its points."""

from dataclasses import replace
from typing import Any

import numpy as np

from core.index.map_index import MapIndex
from core.scan.ply.writer import encode_ply
from core.scan.point_cloud import PointCloud
from service.jobs import MAX_SAMPLE_POINTS
from service.worker.answer_body import json_safe


def stats_of(cloud: PointCloud, index: MapIndex, index_bytes: int, seconds: dict[str, float]) -> dict[str, Any]:
    """Return `stats` of a map as the HTTP contract promises them, positions in the scan's own frame, metres."""
    lower, upper = index.bounds
    stats: dict[str, Any] = json_safe(
        {
            "num_points": cloud.num_points_read or len(cloud),
            "num_points_used": index.num_points,
            "bounds": {"min": lower, "max": upper},
            "origin_offset": index.origin_offset,
            "num_starts": index.num_starts,
            "index_bytes": index_bytes,
            "seconds": seconds,
        }
    )
    return stats


def starts_of(index: MapIndex) -> list[dict[str, Any]]:
    """Return position and leaf size of every start, metres, in the scan's own frame."""
    return [
        {"position_m": position, "leaf_size_m": size}
        for position, size in zip(index.start_positions.tolist(), index.start_leaf_sizes.tolist(), strict=True)
    ]


def sample_ply(cloud: PointCloud) -> bytes:
    """Return at most MAX_SAMPLE_POINTS coloured points as a binary PLY, shuffled so that every prefix is fair."""
    chosen = np.random.default_rng(0).permutation(len(cloud))[:MAX_SAMPLE_POINTS]
    return encode_ply(replace(cloud, positions=cloud.positions[chosen], colors=cloud.colors[chosen]))
