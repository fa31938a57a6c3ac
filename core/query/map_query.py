"""One map of a query: what it asks of poses there, and how they are rendered, judged and aligned."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.agreement import agreement, with_agreement
from panoloc.core.decide.hypotheses import Hypothesis, by_map, stacked_poses
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.query.focal_lengths import with_other_focal_lengths
from panoloc.core.query.prepared_rig import PreparedRig
from panoloc.core.refine.aligned_points import (
    StartViews,
    points_seen_from_poses,
    points_seen_from_starts,
    views_from_starts,
)
from panoloc.core.refine.step import PointPlanes
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import RENDER_BATCH
from panoloc.core.search.map_search import LineEvidence, MapSearch
from panoloc.core.search.pose_limits import PoseLimits, pose_limits, within_reach


class MapQuery:
    """One map of a query: its number among them, its index, the limits of the rig's pose in it, and the rig in its colours."""

    def __init__(self, number: int, index: MapIndex, limits: PoseLimits, rig: PreparedRig) -> None:
        self.number, self.index, self.limits, self.rig, self.config = number, index, limits, rig, rig.config
        # The row of each start in the views, and what the starts see.
        self._seen: tuple[dict[int, int], StartViews] | None = None

    @property
    def cloud(self) -> RenderCloud:
        """Return the map's points, ready for rendering."""
        return self.index.render_cloud

    @cached_property
    def lines(self) -> LineEvidence | None:
        """Return what the edges of the images say of rotations; None where that is little."""
        rig, index = self.rig, self.index
        if rig.is_wide or rig.is_labels:
            return None
        evidence = LineEvidence(rig.lines, index.wall_axes, self.limits, self.config.search)
        return evidence if evidence.contrast >= self.config.lines.least_contrast else None

    @cached_property
    def search(self) -> MapSearch:
        """Return the map, ready to be searched."""
        return MapSearch(self.rig.described, self.index, self.lines, self.rig.is_wide, self.config.search)

    def with_other_focal_lengths(self, best: Hypothesis, comparison: Comparison) -> list[Hypothesis]:
        """Return where the camera of a pose would stand with the other focal lengths that it may have; comparison: of that pose alone."""
        if self.rig.prior is None:
            return []
        axis = self.rig.pyramid.rotations[0][:, 0]
        return with_other_focal_lengths(best, comparison, self.rig.prior, axis, self.config.focal)

    def allows(self, hypothesis: Hypothesis) -> bool:
        """Return whether the hints allow the pose."""
        return self.limits.allows_pose(hypothesis.rotation, hypothesis.position)

    def compare(self, group: Sequence[Hypothesis], rows: int, with_points: bool = False) -> Comparison:
        """Render the scan at every pose, in `rows` rows to a sphere, beside what the images show."""
        focals = self.rig.log_focals(group)
        return self.rig.view.compare(self.cloud, *stacked_poses(group), rows, with_points, focals)

    def judge(self, group: Sequence[Hypothesis], is_first: bool = False) -> list[Hypothesis]:
        """Return the hypotheses with the score and measures of renderings; is_first: of coarse ones, where there are many poses."""
        rows = self.config.descriptors.view_height if is_first else self.rig.rows
        parts = [group[first : first + RENDER_BATCH] for first in range(0, len(group), RENDER_BATCH)]
        return [judged for part in parts for judged in self._judged(part, self.compare(part, rows))]

    def judge_alone(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Comparison]:
        """Return one hypothesis judged on the largest rendering, with how thick surfaces of the scan are, and the comparison."""
        comparison = self.compare([hypothesis], 2 * self.rig.rows)
        judged = self._judged([hypothesis], comparison)[0]
        measures = judged.measures | {"thickness_m": self.index.surface_thickness_m}
        return replace(judged, measures=measures), comparison

    def _judged(self, group: Sequence[Hypothesis], comparison: Comparison) -> list[Hypothesis]:
        """Return hypotheses with the measures of a comparison, and how well lines agree with their rotations."""
        agreeing = None if self.lines is None else 1 - self.lines.missed(stacked_poses(group)[0])
        measured = agreement(comparison, self.config.judge, self.rig.shares(group), self.rig.patch_deg, agreeing)
        return with_agreement(group, replace(measured, score=measured.score * self.rig.likelihoods(group)))

    def points_from_starts(self, group: Sequence[Hypothesis], coarse: bool) -> PointPlanes:
        """Return what the starts of the hypotheses see, with colours of half the views' resolution or all of it."""
        sizes, rig = self.config.refinement, self.rig
        rows, views = self._views_from(sorted({h.start for h in group}))
        look = rig.look(sizes.coarse_points_of(rig.share), rig.margin_deg, 2 * self.config.descriptors.patch_deg)
        numbers = rig.numbers_of([rows[h.start] for h in group])
        return points_seen_from_starts(
            rig.pyramid, self.cloud, views, numbers, *stacked_poses(group), look, coarse, sizes.contrast
        )

    def points_from_poses(
        self, group: Sequence[Hypothesis], comparison: Comparison, count: int, patch_deg: float, contrast: float
    ) -> PointPlanes:
        """Return `count` points that the poses compared see, in patches of `patch_deg`."""
        look = self.rig.look(count, self.config.refinement.margin_deg, patch_deg)
        return points_seen_from_poses(self.rig.view, self.cloud, comparison, *stacked_poses(group), look, contrast)

    def _views_from(self, starts: list[int]) -> tuple[dict[int, int], StartViews]:
        """Return the row of each start in the views, and the views."""
        if self._seen is None or not self._seen[0].keys() >= set(starts):
            rows = self.config.descriptors.view_height
            views = views_from_starts(self.index, self.rig.numbers_of(starts), rows)
            self._seen = {start: row for row, start in enumerate(starts)}, views
        return self._seen


def prepare_queries(rig: Rig, maps: Sequence[MapIndex], hints: Hints | None, config: LocalizerConfig) -> list[MapQuery]:
    """Prepare a rig for each map. Raises OptionsError for hints out of range."""
    limits = [within_reach(pose_limits(hints, index), index) for index in maps]
    shared: PreparedRig | None = None
    queries = []
    for number, (index, limit) in enumerate(zip(maps, limits, strict=True)):
        if index.labels is None:
            shared = prepared = shared or PreparedRig(rig, None, index.positions.device, config)
        else:
            prepared = PreparedRig(rig, index.labels, index.positions.device, config)
        queries.append(MapQuery(number, index, prepared.limits_of_rig(limit), prepared))
    return queries


def by_colors(
    queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]
) -> Iterator[tuple[PreparedRig, list[Hypothesis]]]:
    """Yield the hypotheses, map by map, in groups whose maps share the colours of the rig."""
    groups: dict[PreparedRig, list[Hypothesis]] = {}
    for number, part in by_map(hypotheses):
        groups.setdefault(queries[number].rig, []).extend(part)
    yield from groups.items()


def map_numbers(group: Sequence[Hypothesis], device: torch.device) -> Tensor:
    """Return the numbers (K,) of the maps of hypotheses."""
    return torch.tensor([h.map_number for h in group], device=device)
