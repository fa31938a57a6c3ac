"""A query, prepared: what was photographed, for all maps that share its colours, and each map with what the query asks of it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch

from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Session
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.agreement import agreement, with_agreement
from panoloc.core.decide.hypotheses import Hypothesis, by_map, stacked_poses
from panoloc.core.features.line_hold import LineHold
from panoloc.core.geometry.rotations import rotation_angle
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Hints
from panoloc.core.prepared_panorama import PreparedPanorama
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.refine.candidate_points import points_seen_from_poses, points_seen_from_starts, unchanged_share
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import RENDER_BATCH
from panoloc.core.search.line_evidence import LineEvidence
from panoloc.core.search.photo_search import line_rotations
from panoloc.core.search.pose_limits import PoseLimits, pose_limits, within_reach

_HELD_BACK = math.radians(0.5)  # less is within what refinement is off by


class MapQuery:
    """One map of a query: its number among them, its index, what the hints allow in it, and the panorama or the photos in its
    colours."""

    def __init__(
        self,
        number: int,
        index: MapIndex,
        limits: PoseLimits,
        picture: PreparedPanorama | PreparedPhotos,
        config: LocalizerConfig,
    ) -> None:
        self.number, self.index, self.limits, self.picture, self.config = number, index, limits, picture, config
        # The row of each start, and what the starts see at half and at full resolution.
        self._seen: tuple[dict[int, int], tuple[CandidatePoints, CandidatePoints]] | None = None

    @property
    def cloud(self) -> RenderCloud:
        """Return the map's points, ready for rendering."""
        return self.index.render_cloud

    def allows(self, hypothesis: Hypothesis) -> bool:
        """Return whether the hints allow the pose."""
        return self.limits.allows_pose(hypothesis.rotation, hypothesis.position)

    def within_limits(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return the hypothesis, turned back where it tilts more than the hints allow."""
        if not self.limits.bounds_tilts:  # the usual case, in which a GPU need not be waited for
            return replace(hypothesis, is_held_back=False)
        rotation = self.limits.nearest_rotations(hypothesis.rotation[None])[0]
        is_held_back = float(rotation_angle(rotation, hypothesis.rotation)) > _HELD_BACK
        return replace(hypothesis, rotation=rotation, is_held_back=is_held_back)

    @cached_property
    def lines(self) -> LineEvidence | None:
        """Return what the edges of photos say of rotations; None where that is little, or the walls of the map are not along two axes."""
        picture, index, sizes = self.picture, self.index, self.config.lines
        if not isinstance(picture, PreparedPhotos) or picture.labels is not None:
            return None
        axes, share = index.wall_axes
        if share < sizes.least_walls or picture.edges().count < sizes.fewest_edges:
            return None
        every = line_rotations(self.config.photo_search, index.positions.device)
        evidence = LineEvidence(picture.lines(), axes, every, self.limits)
        return evidence if evidence.contrast >= sizes.least_contrast else None

    def held(self, points: CandidatePoints, group: Sequence[Hypothesis], strength: float) -> CandidatePoints:
        """Return the points of photos, with the hold that lines have on those of a group of hypotheses whose rotations they agree with."""
        assert isinstance(self.picture, PreparedPhotos)
        if points.patches is None:
            return points
        sizes, rotations = self.config.lines, stacked_poses(group)[0]
        strengths = torch.zeros(len(group), device=rotations.device)
        if self.lines is not None:
            missed = self.lines.missed(rotations)
            strengths = strength * (1 - missed / sizes.held_within).clamp_min(0.0)
        axes = self.index.wall_axes[0].expand(len(group), 3, 3)
        edges = self.picture.edges().some(sizes.hold_edges)
        return replace(points, lines=LineHold(edges, axes, strengths, sizes))

    def compare(self, group: Sequence[Hypothesis], height: int, with_points: bool = False) -> Comparison:
        """Render the scan at every pose, in `height` rows, beside what was photographed."""
        return self.picture.compare(self.cloud, *stacked_poses(group), height, with_points)

    def judge(self, group: Sequence[Hypothesis], height: int) -> list[Hypothesis]:
        """Return the hypotheses with the score and measures of renderings of `height` rows."""
        judged: list[Hypothesis] = []
        for first in range(0, len(group), RENDER_BATCH):
            part = group[first : first + RENDER_BATCH]
            measured = agreement(self.compare(part, height), self.config.judge, self.picture.share)
            judged += self._as_lines_agree(with_agreement(part, measured))
        return judged

    def judge_alone(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Comparison]:
        """Return one hypothesis judged on the larger rendering, and the comparison."""
        comparison = self.compare([hypothesis], self.config.judge.final_height)
        measured = agreement(comparison, self.config.judge, self.picture.share)
        (judged,) = self._as_lines_agree(with_agreement([hypothesis], measured))
        return judged, comparison

    def _as_lines_agree(self, group: list[Hypothesis]) -> list[Hypothesis]:
        """Return hypotheses with a smaller score the less lines agree with their rotations, and how well they do among the measures."""
        if self.lines is None or not group:
            return group
        agreeing = (1 - self.lines.missed(stacked_poses(group)[0])).tolist()
        lost = self.config.judge.lines_share
        return [
            replace(h, score=h.score * (1 - lost * (1 - share)), measures=h.measures | {"lines": share})
            for h, share in zip(group, agreeing, strict=True)
        ]

    def points_from_starts(self, group: Sequence[Hypothesis], coarse: bool) -> CandidatePoints:
        """Return what the starts of the hypotheses see, with colours of half the views' resolution or all of it."""
        if isinstance(self.picture, PreparedPhotos):
            points = self.picture.points_from_starts(self.index, group, coarse)
            return self.held(points, group, self.config.lines.hold_strengths[0])
        starts = sorted({h.start for h in group})
        if self._seen is None or not self._seen[0].keys() >= set(starts):
            height, sizes = self.config.descriptors.view_height, self.config.refinement
            chosen = torch.tensor(starts, device=self.index.starts.device)
            seen = points_seen_from_starts(self.index, chosen, height, sizes.coarse_points, sizes.contrast_share)
            self._seen = {start: row for row, start in enumerate(starts)}, seen
        rows, by_resolution = self._seen
        points = by_resolution[0 if coarse else 1]
        return points.take(torch.tensor([rows[h.start] for h in group], device=points.weights.device))

    def points_from_poses(self, group: Sequence[Hypothesis]) -> CandidatePoints:
        """Return what the poses themselves see, with a smaller weight where it has changed since the scan."""
        sizes = self.config.refinement
        comparison = self.compare(group, self.config.judge.height, with_points=True)
        weights = unchanged_share(comparison, sizes)
        if isinstance(self.picture, PreparedPhotos):
            return self.picture.points_from_poses(
                self.cloud, comparison, group, sizes.middle_points, sizes.contrast_share, weights
            )
        return points_seen_from_poses(self.cloud, comparison, sizes.middle_points, sizes.contrast_share, weights)

    def points_by_patches(self, group: Sequence[Hypothesis], patch_deg: float) -> CandidatePoints:
        """Return what the poses of a group themselves see and the photos show, to be aligned by patches of `patch_deg` degrees."""
        assert isinstance(self.picture, PreparedPhotos)
        photos = self.config.photos
        comparison = self.compare(group, self.config.judge.height, with_points=True)
        count, share = photos.middle_points, photos.patch_contrast_share
        points = self.picture.points_from_poses(self.cloud, comparison, group, count, share, None, patch_deg)
        return self.held(points, group, self.config.lines.hold_strengths[1])

    def full_points(self, hypothesis: Hypothesis, comparison: Comparison, count: int) -> CandidatePoints:
        """Return the points of one pose for a refinement at full resolution, with the colours of the comparison."""
        share = self.config.refinement.fine_contrast_share
        if isinstance(self.picture, PreparedPhotos):
            patch_deg = None if self.picture.labels is not None else self.config.photos.fine_patch_deg
            points = self.picture.points_from_poses(self.cloud, comparison, [hypothesis], count, share, None, patch_deg)
            return self.held(points, [hypothesis], self.config.lines.hold_strengths[2])
        return points_seen_from_poses(self.cloud, comparison, count, share)

    def points_with_patches(self, hypothesis: Hypothesis, comparison: Comparison) -> CandidatePoints:
        """Return the points of one pose of photos, in patches of those of full resolution whatever their colours are."""
        assert isinstance(self.picture, PreparedPhotos)
        photos = self.config.photos
        count, share, patch_deg = photos.fine_points, photos.patch_contrast_share, photos.fine_patch_deg
        points = self.picture.points_from_poses(self.cloud, comparison, [hypothesis], count, share, None, patch_deg)
        return self.held(points, [hypothesis], self.config.lines.hold_strengths[2])


def prepare_queries(
    query: Panorama | Session, maps: Sequence[MapIndex], hints: Hints | None, max_height: int, config: LocalizerConfig
) -> list[MapQuery]:
    """Prepare a panorama or photos, of up to `max_height` rows, for each map. Raises OptionsError for hints out of range."""
    limits = [within_reach(pose_limits(hints, index), index, config.search.reach_m) for index in maps]
    shared: PreparedPanorama | PreparedPhotos | None = None
    queries = []
    for number, (index, limit) in enumerate(zip(maps, limits, strict=True)):
        prepared = shared
        if index.labels is not None or prepared is None:
            prepared = _prepared(query, index, max_height, config)
        if index.labels is None:
            shared = prepared
        if isinstance(prepared, PreparedPhotos):
            limit = prepared.limits_of_rig(limit)
        queries.append(MapQuery(number, index, limit, prepared, config))
    return queries


def _prepared(
    query: Panorama | Session, index: MapIndex, rows: int, config: LocalizerConfig
) -> PreparedPanorama | PreparedPhotos:
    device = index.positions.device
    if isinstance(query, Panorama):
        return PreparedPanorama(query, rows, index.labels, device)
    return PreparedPhotos(query, rows, index.labels, device, config)


def by_colors(
    queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]
) -> Iterator[tuple[PreparedPanorama | PreparedPhotos, list[Hypothesis]]]:
    """Yield the hypotheses, map by map, in groups whose maps share the colours of what was photographed."""
    groups: dict[PreparedPanorama | PreparedPhotos, list[Hypothesis]] = {}
    for number, part in by_map(hypotheses):
        groups.setdefault(queries[number].picture, []).extend(part)
    yield from groups.items()


def within_limits(queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses, those that tilt more than the hints allow turned back."""
    return [queries[h.map_number].within_limits(h) for h in hypotheses]


@dataclass(frozen=True)
class SearchRound:
    """One search of all maps of a query: the limits in each map, whether only rotations are searched that lines agree with, and how many
    candidates it has."""

    limits: list[PoseLimits]
    by_lines: bool
    num_candidates: int


def search_rounds(queries: Sequence[MapQuery], config: LocalizerConfig) -> list[SearchRound]:
    """Return the searches that a query takes one after the other, until an answer is sure.

    Of photos first those poses that cameras held level leave, and of these the ones that lines agree with, where there are any to ask.
    """
    limits, search = [query.limits for query in queries], config.photo_search
    tilt = math.radians(search.level_tilt_deg)
    everything = SearchRound(limits, False, config.search.num_candidates)
    leaves_tilts = any(isinstance(q.picture, PreparedPhotos) and q.limits.leaves_tilts_beyond(tilt) for q in queries)
    first = [replace(limit, max_tilt=tilt) for limit in limits] if leaves_tilts else limits
    if any(query.lines is not None for query in queries):
        return [SearchRound(first, True, search.level_candidates), everything]
    return [SearchRound(first, False, search.level_candidates), everything] if leaves_tilts else [everything]
