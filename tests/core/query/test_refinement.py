"""The refinement of one pose of a query at full resolution."""

from dataclasses import replace

import pytest

from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.options import IndexOptions
from panoloc.core.query.refinement import Refinement
from tests.core.built_maps import BOX, POSE, panorama, rig_of, tensors_of
from tests.core.search.found_candidates import CONFIG, query_of

pytestmark = pytest.mark.slow


def test_where_a_scan_has_few_points_these_are_what_is_aligned_and_not_the_gaps_between_them() -> None:
    index = build_map_index(BOX.scan(1500), IndexOptions(spacing_m=2.0))
    rotation, position = tensors_of(POSE)

    def share_seen(least_filled: float) -> float:
        """Return the share of the points to align on that are there."""
        config = replace(CONFIG, refinement=replace(CONFIG.refinement, least_filled=least_filled))
        query = query_of(rig_of(panorama()), index=index, config=config)
        refinement = Refinement([query], config)
        _, points = refinement.fine(query, Hypothesis(0, 0, rotation[0], position[0]))
        return float((points.weights > 0).float().mean())

    assert share_seen(0.0) < 0.1
    assert share_seen(CONFIG.refinement.least_filled) > 0.1
