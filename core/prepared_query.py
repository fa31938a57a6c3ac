"""A query, prepared: what was photographed, for all maps that share its colours, and each map with what the query asks of it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch

from core.config import LocalizerConfig, PhotoSearchConfig
from core.geometry.rotations import rotation_angle
from core.index.map_index import MapIndex
from core.judge.agreement import agreement, with_agreement
from core.judge.hypotheses import Hypothesis, by_map, stacked_poses
from core.options import Hints
from core.panorama.panorama import Panorama
from core.panorama.session import Session
from core.prepared_panorama import PreparedPanorama
from core.prepared_photos import PreparedPhotos
from core.refine.candidate_points import points_seen_from_poses, points_seen_from_starts, unchanged_share
from core.refine.refinement import CandidatePoints
from core.search.pose_limits import PoseLimits, pose_limits, within_reach
from core.views.comparison import Comparison
from core.views.render_cloud import RenderCloud
from core.views.synthetic_view import RENDER_BATCH

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
        rotation = self.limits.nearest_rotations(hypothesis.rotation[None])[0]
        is_held_back = float(rotation_angle(rotation, hypothesis.rotation)) > _HELD_BACK
        return replace(hypothesis, rotation=rotation, is_held_back=is_held_back)

    def compare(self, group: Sequence[Hypothesis], height: int, with_points: bool = False) -> Comparison:
        """Render the scan at every pose, in `height` rows, beside what was photographed."""
        return self.picture.compare(self.cloud, *stacked_poses(group), height, with_points)

    def judge(self, group: Sequence[Hypothesis], height: int) -> list[Hypothesis]:
        """Return the hypotheses with the score and measures of renderings of `height` rows."""
        judged: list[Hypothesis] = []
        for first in range(0, len(group), RENDER_BATCH):
            part = group[first : first + RENDER_BATCH]
            judged += with_agreement(part, agreement(self.compare(part, height), self.config.judge, self.picture.share))
        return judged

    def judge_alone(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Comparison]:
        """Return one hypothesis judged on the larger rendering, and the comparison."""
        comparison = self.compare([hypothesis], self.config.judge.final_height)
        (judged,) = with_agreement([hypothesis], agreement(comparison, self.config.judge, self.picture.share))
        return judged, comparison

    def points_from_starts(self, group: Sequence[Hypothesis], coarse: bool) -> CandidatePoints:
        """Return what the starts of the hypotheses see, with colours of half the views' resolution or all of it."""
        if isinstance(self.picture, PreparedPhotos):
            return self.picture.points_from_starts(self.index, group, coarse)
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
        return self.picture.points_from_poses(self.cloud, comparison, group, count, share, None, patch_deg)

    def full_points(self, hypothesis: Hypothesis, comparison: Comparison, count: int) -> CandidatePoints:
        """Return the points of one pose for a refinement at full resolution, with the colours of the comparison."""
        share = self.config.refinement.fine_contrast_share
        if isinstance(self.picture, PreparedPhotos):
            patch_deg = None if self.picture.labels is not None else self.config.photos.fine_patch_deg
            return self.picture.points_from_poses(self.cloud, comparison, [hypothesis], count, share, None, patch_deg)
        return points_seen_from_poses(self.cloud, comparison, count, share)


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


def search_limits(queries: Sequence[MapQuery], config: PhotoSearchConfig) -> list[list[PoseLimits]]:
    """Return the limits of one search of all maps after the other: of photos first those that cameras held level leave."""
    limits, tilt = [query.limits for query in queries], math.radians(config.level_tilt_deg)
    if not any(isinstance(q.picture, PreparedPhotos) and q.limits.leaves_tilts_beyond(tilt) for q in queries):
        return [limits]
    return [[replace(limit, max_tilt=tilt) for limit in limits], limits]
