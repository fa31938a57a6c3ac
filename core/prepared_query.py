"""A query, prepared: the panorama for all maps that share its colours, and each map with what the query asks of it."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from core.config import DescriptorConfig, LocalizerConfig
from core.geometry.projection import wrap_border
from core.index.map_index import MapIndex
from core.judge.agreement import agreement, with_agreement
from core.judge.hypotheses import Hypothesis, by_map, stacked_poses
from core.light.color_equalization import LabelCodes
from core.light.local_contrast import mixed_with_contrast
from core.options import Hints
from core.panorama.image_level import ImageLevel, prepare_level
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaLevel, PanoramaPyramid
from core.refine.candidate_points import points_seen_from_poses, points_seen_from_starts, unchanged_share
from core.refine.refinement import CandidatePoints
from core.search.map_search import DescribedPanorama, describe_panorama
from core.search.pose_limits import PoseLimits, pose_limits
from core.views.comparison import Comparison, compare
from core.views.render_cloud import RenderCloud
from core.views.synthetic_view import RENDER_BATCH


class PreparedPanorama:
    """The panorama's levels and descriptors, each made once: for all maps of colours, or for one of labels."""

    def __init__(self, panorama: Panorama, max_height: int, labels: LabelCodes | None, device: torch.device) -> None:
        self.labels = labels
        self.pyramid = PanoramaPyramid(panorama, max_height, labels, device)
        self._described: DescribedPanorama | None = None
        self._levels: dict[tuple[int, float, bool], ImageLevel] = {}

    def described(self, config: DescriptorConfig) -> DescribedPanorama:
        """Return the panorama's descriptors."""
        if self._described is None:
            self._described = describe_panorama(self.pyramid, self.labels, config)
        return self._described

    def canonical_level(self, height: int, contrast_share: float, blur: bool = False) -> ImageLevel:
        """Return a level equalized over the whole panorama and mixed with contrast, prepared for sampling; blurred for the widest basin."""
        key = (height, contrast_share, blur)
        if key not in self._levels:
            level = self.pyramid.level(height)
            color = level.canonical(self.labels)
            if self.labels is None:
                color = _with_contrast(color, level, contrast_share)
            self._levels[key] = prepare_level(_blur(color, level.valid) if blur else color, level.valid)
        return self._levels[key]

    def level_for(self, comparison: Comparison, height: int, contrast_share: float) -> ImageLevel:
        """Return a level with the colours of the one pose compared: its own equalization mixed with contrast, or label codes."""
        level = self.pyramid.level(height)
        if comparison.tables is None:
            return prepare_level(level.color, level.valid)
        recolored = level.recolored(comparison.tables[0])
        return prepare_level(_with_contrast(recolored, level, contrast_share), level.valid)


class MapQuery:
    """One map of a query: its number among them, its index, what the hints allow in it, and the panorama in its colours."""

    def __init__(
        self, number: int, index: MapIndex, limits: PoseLimits, panorama: PreparedPanorama, config: LocalizerConfig
    ) -> None:
        self.number, self.index, self.limits, self.panorama, self.config = number, index, limits, panorama, config
        # The row of each start, and what the starts see at half and at full resolution.
        self._seen: tuple[dict[int, int], tuple[CandidatePoints, CandidatePoints]] | None = None

    @property
    def cloud(self) -> RenderCloud:
        """Return the map's points, ready for rendering."""
        return self.index.render_cloud

    def allows(self, hypothesis: Hypothesis) -> bool:
        """Return whether the hints allow the pose."""
        return self.limits.allows_pose(hypothesis.rotation, hypothesis.position)

    def compare(self, group: Sequence[Hypothesis], height: int, with_points: bool = False) -> Comparison:
        """Render the scan at every pose, in `height` rows, beside the panorama."""
        level, is_labels = self.panorama.pyramid.level(height), self.index.labels is not None
        return compare(self.cloud, level, *stacked_poses(group), height, is_labels, with_points)

    def judge(self, group: Sequence[Hypothesis], height: int) -> list[Hypothesis]:
        """Return the hypotheses with the score and measures of renderings of `height` rows."""
        judged: list[Hypothesis] = []
        for first in range(0, len(group), RENDER_BATCH):
            part = group[first : first + RENDER_BATCH]
            judged += with_agreement(part, agreement(self.compare(part, height), height, self.config.judge))
        return judged

    def judge_alone(self, hypothesis: Hypothesis) -> tuple[Hypothesis, Comparison]:
        """Return one hypothesis judged on the larger rendering, and the comparison."""
        height = self.config.judge.final_height
        comparison = self.compare([hypothesis], height)
        return with_agreement([hypothesis], agreement(comparison, height, self.config.judge))[0], comparison

    def points_from_starts(self, group: Sequence[Hypothesis], coarse: bool) -> CandidatePoints:
        """Return what the starts of the hypotheses see, with colours of half the views' resolution or all of it."""
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
        return points_seen_from_poses(self.cloud, comparison, sizes.middle_points, sizes.contrast_share, weights)


def prepare_queries(
    panorama: Panorama, maps: Sequence[MapIndex], hints: Hints | None, max_height: int, config: LocalizerConfig
) -> list[MapQuery]:
    """Prepare a panorama of up to `max_height` rows for each map. Raises OptionsError for hints out of range."""
    limits = [pose_limits(hints, index) for index in maps]
    shared: PreparedPanorama | None = None
    queries = []
    for number, index in enumerate(maps):
        prepared = shared
        if index.labels is not None or prepared is None:
            prepared = PreparedPanorama(panorama, max_height, index.labels, index.positions.device)
        if index.labels is None:
            shared = prepared
        queries.append(MapQuery(number, index, limits[number], prepared, config))
    return queries


def by_colors(
    queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]
) -> Iterator[tuple[PreparedPanorama, list[Hypothesis]]]:
    """Yield the hypotheses, map by map, in groups whose maps share the panorama's colours."""
    groups: dict[PreparedPanorama, list[Hypothesis]] = {}
    for number, part in by_map(hypotheses):
        groups.setdefault(queries[number].panorama, []).extend(part)
    yield from groups.items()


def _with_contrast(equalized: Tensor, level: PanoramaLevel, share: float) -> Tensor:
    """Mix equalized colours (3, H, W) of a level with its local contrast."""
    as_views = equalized.permute(1, 2, 0)[None], level.color.permute(1, 2, 0)[None], level.valid[None]
    return mixed_with_contrast(*as_views, share)[0].permute(2, 0, 1)


def _blur(color: Tensor, valid: Tensor) -> Tensor:
    """Smooth (3, H, W) over valid pixels (H, W) with the kernel 1 2 1 along both axes, around the seam and over the poles."""
    padded = wrap_border(torch.cat((color * valid, valid[None])))
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    total = rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]
    return total[:3] / total[3:].clamp_min(1.0)
