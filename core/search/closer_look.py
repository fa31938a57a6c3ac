"""A closer look around a place that was found: the photo searched once more there, with more candidates than the whole map gets.

What a photo shows may fit nearly as well half a metre or fifteen degrees from where it was taken, above all where much has changed. Of the
poses there the search of the whole map proposes a few, and may miss the right one: then the wrong one seems to have no rival.
"""

import math
from dataclasses import replace

from torch import Tensor

from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.map.map_index import MapIndex
from panoloc.core.search.described_photos import DescribedPhotos
from panoloc.core.search.line_evidence import LineEvidence
from panoloc.core.search.map_search import MapCandidates
from panoloc.core.search.photo_search import dense_rotations, line_rotations, search_likely, search_rotations
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.search.position_sweep import swept


def search_around(
    photos: DescribedPhotos,
    index: MapIndex,
    limits: PoseLimits,
    lines: LineEvidence | None,
    rotation: Tensor,
    position: Tensor,
    config: LocalizerConfig,
) -> MapCandidates:
    """Search for photos in a map near a pose of their rig, (3, 3) map_from_rig and (3,), in axes of the index.

    Of the caller's limits those of a distance from a point give way to the place itself: what is refined from there has to keep to them
    anyhow. The others hold.
    """
    search, fine = config.photo_search, config.fine_views
    near = replace(limits, center=position, radius_m=search.closer_m)
    apart = replace(search, distinct=search.closer_distinct, num_candidates=search.closer_candidates)
    every = dense_rotations(search, rotation.device) if lines is None else line_rotations(search, rotation.device)
    is_near = rotation_angle(every, rotation) < math.radians(search.closer_deg)
    if lines is None:
        rotations = every[is_near]
        rotations = rotations[limits.allows_rotation(rotations, math.radians(search.limit_margin_deg))]
        return search_rotations(photos, index, near, rotations, search.closer_poses, apart, fine)
    likely = lines.likely_rotations(limits, search, is_near)
    some = replace(search, num_candidates=search.swept, distinct=search.swept_distinct)
    found = search_likely(photos, index, near, likely, some, fine)
    return swept(photos, index, found, apart)
