"""A rig and each map of a query, ready for it: what it asks of poses there, and how they are rendered, judged and aligned."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.agreement import agreement, with_agreement
from panoloc.core.decide.hypotheses import Hypothesis, by_map, stacked_poses
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.features.line_support import Edges, LineSupport, edges_of_photos
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.image.photo_window import shown_share
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import MAX_SESSION_TILT_DEG, Hints
from panoloc.core.query.focal_lengths import focal_prior
from panoloc.core.refine.aligned_points import (
    LookDirections,
    StartViews,
    look_directions,
    points_seen_from_poses,
    points_seen_from_starts,
    views_from_starts,
)
from panoloc.core.refine.step import PointPlanes
from panoloc.core.render.comparison import Comparison, RigView
from panoloc.core.render.synthetic_view import RENDER_BATCH
from panoloc.core.search.described_rig import DescribedRig
from panoloc.core.search.map_search import LineEvidence, MapSearch
from panoloc.core.search.pose_limits import PoseLimits, pose_limits, within_reach


class PreparedRig:
    """A rig in the colours of some maps.

    is_wide: whether it covers so much of the sphere that patches of 22 degrees tell it apart. finer: how many times as closely it is looked
    at as a panorama is. is_labels: whether colours are codes of labels. rows: of the coarse renderings that poses are judged on; patch_deg:
    how many degrees the patches are high and wide that they are judged by, as many rows of any rendering. margin_deg: how far around what
    the images show points are aligned while poses may turn.
    given: the rig that this one is a guess at: guesses are looked at as closely as that, or their scores would not compare.
    """

    def __init__(
        self,
        rig: Rig,
        labels: LabelCodes | None,
        device: torch.device,
        config: LocalizerConfig,
        given: Rig | None = None,
    ) -> None:
        self.config, self._camera = config, rig.photos[0].camera
        own = share = shown_share(rig)
        self._weight = 1.0
        if given is not None and given is not rig:
            share = shown_share(given)
            self._weight = config.focal.stated * math.pow(own / share, config.focal.chance)
        self.is_wide = share >= config.search.wide_share
        self.finer = 2 if share < config.search.narrow_share else 1
        self.pyramid = RigPyramid(rig, 2 * self.finer * config.refinement.fine_rows, labels, device)
        self.share = self.pyramid.share
        self.colors = CanonicalColors(self.pyramid)
        self.view = RigView(self.pyramid, config.refinement.margin_deg)
        self.prior = focal_prior(rig, config.focal)
        self.is_labels = labels is not None
        self.rows = self.finer * config.descriptors.view_height
        self.patch_deg = 2 * config.descriptors.patch_deg / self.finer
        self.margin_deg = config.refinement.coarse_margin_deg * (1.0 if self.finer > 1 else 0.5)
        self._look: dict[tuple[int, float, float], LookDirections] = {}

    def log_focals(self, group: Sequence[Hypothesis]) -> Tensor | None:
        """Return the logarithms (K,) of the focal lengths of hypotheses over those given; None where all are as given."""
        if all(h.log_focal is None for h in group):
            return None
        return torch.tensor([h.log_focal or 0.0 for h in group], device=self.pyramid.rotations.device)

    def shares(self, group: Sequence[Hypothesis]) -> Tensor:
        """Return the shares (K,) of the sphere that the images show with the focal lengths of hypotheses, as far as views of them go."""
        own = self._camera.solid_angle()
        shares = [self.share * min(1.0, self._camera.solid_angle(math.exp(h.log_focal or 0.0)) / own) for h in group]
        return torch.tensor(shares, device=self.pyramid.rotations.device)

    def likelihoods(self, group: Sequence[Hypothesis]) -> Tensor:
        """Return by how much less (K,) the scores of hypotheses count whose focal lengths are others than stated, or longer than they need
        be: the less of the sphere an image shows, the more easily it fits by chance."""
        prior, focal = self.prior, self.config.focal
        if prior is None:
            less = [self._weight] * len(group)
        elif prior.is_stated:
            less = [1.0 if h.log_focal is None else focal.stated for h in group]
        else:
            less = [self.chance_weight(h.log_focal) / self.chance_weight(prior.least) for h in group]
        return torch.tensor(less, device=self.pyramid.rotations.device)

    def chance_weight(self, log_focal: float | None) -> float:
        """Return the weight of a score with a focal length, the logarithm of its factor: the less of the sphere an image shows, the more
        easily it fits by chance."""
        return math.pow(self._camera.solid_angle(math.exp(log_focal or 0.0)), self.config.focal.chance)

    @cached_property
    def described(self) -> DescribedRig:
        """Return what the images look like to the search."""
        return DescribedRig(self.colors, self.config.descriptors)

    @cached_property
    def edges(self) -> Edges:
        """Return the edges of the images."""
        return edges_of_photos(self.pyramid, self.finer * self.config.refinement.fine_rows, self.config.lines)

    @cached_property
    def lines(self) -> LineSupport:
        """Return what the edges of the images say of how the rig is turned."""
        return LineSupport(self.edges, self.config.lines)

    def look(self, count: int, margin_deg: float, patch_deg: float) -> LookDirections:
        """Return `count` directions that the images show and as many around; see `look_directions`."""
        key = count, margin_deg, patch_deg
        if key not in self._look:
            self._look[key] = look_directions(self.pyramid, count, margin_deg, patch_deg)
        return self._look[key]

    def numbers_of(self, values: list[int]) -> Tensor:
        """Return whole numbers on the device of the rig."""
        return torch.tensor(values, device=self.pyramid.rotations.device)


class MapQuery:
    """One map of a query: its number among them, its index, the limits of the rig's pose in it, and the rig in its colours."""

    def __init__(self, number: int, index: MapIndex, limits: PoseLimits, rig: PreparedRig) -> None:
        self.number, self.index, self.limits, self.rig, self.config = number, index, limits, rig, rig.config
        # The row of each start in the views, and what the starts see.
        self._seen: tuple[dict[int, int], StartViews] | None = None

    @cached_property
    def lines(self) -> LineEvidence | None:
        """Return what the edges of the images say of rotations; None where that is little."""
        rig, index = self.rig, self.index
        if rig.is_labels:
            return None
        evidence = LineEvidence(rig.lines, index.wall_axes, self.limits, self.config.search)
        return evidence if evidence.contrast >= self.config.lines.least_contrast else None

    @cached_property
    def search(self) -> MapSearch:
        """Return the map, ready to be searched."""
        return MapSearch(self.rig.described, self.index, self.rig.is_wide, self.config.search)

    def allows(self, hypothesis: Hypothesis) -> bool:
        """Return whether the hints allow the pose."""
        return self.limits.allows_pose(hypothesis.rotation, hypothesis.position)

    def compare(self, group: Sequence[Hypothesis], rows: int, with_points: bool = False) -> Comparison:
        """Render the scan at every pose, in `rows` rows to a sphere, beside what the images show."""
        focals = self.rig.log_focals(group)
        return self.rig.view.compare(self.index.render_cloud, *stacked_poses(group), rows, with_points, focals)

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
        """Return hypotheses with the measures of a comparison, and of narrow rigs how well lines agree with their rotations."""
        lines = None if self.rig.is_wide else self.lines
        agreeing = None if lines is None else 1 - lines.missed(stacked_poses(group)[0])
        measured = agreement(comparison, self.config.judge, self.rig.shares(group), self.rig.patch_deg, agreeing)
        return with_agreement(group, replace(measured, score=measured.score * self.rig.likelihoods(group)))

    def points_from_starts(self, group: Sequence[Hypothesis], coarse: bool) -> PointPlanes:
        """Return what the starts of the hypotheses see, with colours of half the views' resolution or all of it."""
        sizes, rig = self.config.refinement, self.rig
        rows, views = self._views_from(sorted({h.start for h in group}))
        look = rig.look(sizes.coarse_points_of(rig.share), rig.margin_deg, 2 * self.config.descriptors.patch_deg)
        numbers = rig.numbers_of([rows[h.start] for h in group])
        return points_seen_from_starts(
            rig.pyramid, self.index.render_cloud, views, numbers, *stacked_poses(group), look, coarse, sizes.contrast
        )

    def points_from_poses(
        self, group: Sequence[Hypothesis], comparison: Comparison, count: int, patch_deg: float, contrast: float
    ) -> PointPlanes:
        """Return `count` points that the poses compared see, in patches of `patch_deg`."""
        look = self.rig.look(count, self.config.refinement.margin_deg, patch_deg)
        return points_seen_from_poses(
            self.rig.view, self.index.render_cloud, comparison, *stacked_poses(group), look, contrast
        )

    def _views_from(self, starts: list[int]) -> tuple[dict[int, int], StartViews]:
        """Return the row of each start in the views, and the views."""
        if self._seen is None or not self._seen[0].keys() >= set(starts):
            rows = self.config.descriptors.view_height
            views = views_from_starts(self.index, self.rig.numbers_of(starts), rows)
            self._seen = {start: row for row, start in enumerate(starts)}, views
        return self._seen


def prepare_queries(
    rig: Rig, maps: Sequence[MapIndex], hints: Hints | None, config: LocalizerConfig, given: Rig | None = None
) -> list[MapQuery]:
    """Prepare a rig for each map. given: as of `PreparedRig`. Raises OptionsError for hints out of range."""
    limits = [within_reach(pose_limits(hints, index), index) for index in maps]
    tilt = math.radians(MAX_SESSION_TILT_DEG) if rig.options.up_known else None
    prepared: dict[bytes, PreparedRig] = {}
    queries = []
    for number, (index, limit) in enumerate(zip(maps, limits, strict=True)):
        colors = b"" if index.labels is None else index.labels.key
        if colors not in prepared:
            prepared[colors] = PreparedRig(rig, index.labels, index.positions.device, config, given)
        own = prepared[colors]
        of_rig = limit.of_rig(own.pyramid.rotations[0], own.pyramid.centers[0], tilt)
        queries.append(MapQuery(number, index, of_rig, own))
    return queries


def by_colors(
    queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]
) -> Iterator[tuple[PreparedRig, list[Hypothesis]]]:
    """Yield the hypotheses, map by map, in groups whose maps share the colours of the rig."""
    groups: dict[PreparedRig, list[Hypothesis]] = {}
    for number, part in by_map(hypotheses):
        groups.setdefault(queries[number].rig, []).extend(part)
    yield from groups.items()
