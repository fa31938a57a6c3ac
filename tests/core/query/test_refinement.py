"""The refinement of one pose of a query at full resolution."""

from dataclasses import replace

import pytest
import torch

from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.options import Hints, IndexOptions
from panoloc.core.query.refinement import Refinement
from panoloc.core.refine.step import PointPlanes
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


def test_from_beside_a_pose_what_is_so_far_ahead_stays_in_the_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    query, depth_m = query_of(rig_of(panorama())), 2.0
    refinement = Refinement([query], CONFIG)
    rotation, position = tensors_of(POSE)
    began: list[Hypothesis] = []
    monkeypatch.setattr(refinement, "medium", began.extend)
    refinement.from_beside(query, Hypothesis(0, 0, rotation[0], position[0]), depth_m)
    middle = position[0] + depth_m * rotation[0] @ query.rig.pyramid.rotations[0][:, 0]
    moves = []
    for pose in began:
        seen = query.rig.pyramid.rotations[0].T @ pose.rotation.T @ (middle - pose.position)
        torch.testing.assert_close(seen[1:], torch.zeros(2), atol=1e-5, rtol=0)
        moves.append(query.rig.pyramid.rotations[0].T @ rotation[0].T @ (pose.position - position[0]))
    step_m = 2 * CONFIG.focal.step * depth_m
    expected = torch.tensor([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) * step_m
    torch.testing.assert_close(torch.stack(moves), expected, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("max_tilt_deg", "looks"), [(30.0, 0), (2.0, 1)])
def test_beyond_a_limit_of_the_tilt_is_looked_only_where_it_holds_the_pose(
    max_tilt_deg: float, looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = query_of(rig_of(panorama()), Hints(max_tilt_deg=max_tilt_deg))
    refinement = Refinement([query], CONFIG)
    rotation, position = tensors_of(POSE)
    begin = Hypothesis(0, 0, query.limits.nearest_rotations(rotation)[0], position[0])
    thinned, seen = PointPlanes.thinned, list[int]()

    def noted(points: PointPlanes, stride: int) -> PointPlanes:
        seen.append(stride)
        return thinned(points, stride)

    monkeypatch.setattr(PointPlanes, "thinned", noted)
    found, _ = refinement.fine(query, begin)
    assert len(seen) == looks
    assert found.beyond_limits == bool(looks)
    assert bool(query.limits.allows_rotation(found.rotation))
