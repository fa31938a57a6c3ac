"""A query of the `fast` method: what is prepared of the panorama, once for all maps and stages that need the same."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from core.config import LocalizerConfig, SearchConfig
from core.geometry.projection import wrap_border
from core.index.map_index import MapIndex
from core.judge.hypotheses import Hypothesis, by_map
from core.light.local_contrast import mixed_with_contrast
from core.panorama.image_level import ImageLevel, prepare_level
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaLevel, PanoramaPyramid
from core.refine.candidate_points import points_seen_from_starts
from core.refine.refinement import CandidatePoints
from core.search.map_search import DescribedPanorama, describe_panorama
from core.views.render_cloud import RenderCloud


class PreparedQuery:
    """The panorama's levels, prepared once for all maps that share their colours (all but those of labels)."""

    def __init__(self, panorama: Panorama, maps: Sequence[MapIndex], max_height: int, device: torch.device) -> None:
        self.maps = maps
        shared = PanoramaPyramid(panorama, max_height, None, device) if any(m.labels is None for m in maps) else None
        self._pyramids = [
            shared
            if m.labels is None and shared is not None
            else PanoramaPyramid(panorama, max_height, m.labels, device)
            for m in maps
        ]
        self._levels: dict[tuple[int, int, float, bool], ImageLevel] = {}
        # By map: the row of each start, and what the starts see at half and at full resolution.
        self._seen: dict[int, tuple[dict[int, int], tuple[CandidatePoints, CandidatePoints]]] = {}
        self._described: dict[int, DescribedPanorama] = {}

    def pyramid(self, number: int) -> PanoramaPyramid:
        """Return the pyramid for the map with this number."""
        return self._pyramids[number]

    def described(self, number: int, config: SearchConfig) -> DescribedPanorama:
        """Return the panorama's descriptors for the map with this number."""
        pyramid = self._pyramids[number]
        if id(pyramid) not in self._described:
            self._described[id(pyramid)] = describe_panorama(pyramid, self.maps[number].labels, config)
        return self._described[id(pyramid)]

    def by_colors(self, hypotheses: Sequence[Hypothesis]) -> Iterator[tuple[int, list[Hypothesis]]]:
        """Yield the hypotheses, map by map, in groups whose maps share the panorama's colours; and the number of one such map."""
        groups: dict[int, list[Hypothesis]] = {}
        for number, part in by_map(hypotheses):
            groups.setdefault(id(self._pyramids[number]), []).extend(part)
        for group in groups.values():
            yield group[0].map_number, group

    def points_from_starts(
        self, number: int, group: Sequence[Hypothesis], config: LocalizerConfig, coarse: bool
    ) -> CandidatePoints:
        """Return what the starts of hypotheses of one map see, with colours of half the views' resolution or all of it."""
        starts = sorted({h.start for h in group})
        if number not in self._seen or not self._seen[number][0].keys() >= set(starts):
            index, sizes = self.maps[number], config.refinement
            chosen = torch.tensor(starts, device=index.starts.device)
            seen = points_seen_from_starts(
                index, chosen, config.search.view_height, sizes.coarse_points, sizes.contrast_share
            )
            self._seen[number] = {start: row for row, start in enumerate(starts)}, seen
        rows, by_resolution = self._seen[number]
        points = by_resolution[0 if coarse else 1]
        return points.take(torch.tensor([rows[h.start] for h in group], device=points.weights.device))

    def cloud(self, number: int) -> RenderCloud:
        """Return the cloud of a map, ready for rendering."""
        return self.maps[number].render_cloud

    def canonical_level(self, number: int, height: int, contrast_share: float, blur: bool = False) -> ImageLevel:
        """Return a level equalized over the whole panorama and mixed with contrast, prepared for sampling; blurred for the widest basin."""
        pyramid = self._pyramids[number]
        key = (id(pyramid), height, contrast_share, blur)
        if key not in self._levels:
            level, labels = pyramid.level(height), self.maps[number].labels
            color = level.canonical(labels)
            if labels is None:
                color = _with_contrast(color, level, contrast_share)
            self._levels[key] = prepare_level(_blur(color, level.valid) if blur else color, level.valid)
        return self._levels[key]

    def level_for(self, number: int, height: int, tables: Tensor | None, contrast_share: float) -> ImageLevel:
        """Return a level with the colours of one candidate: its own equalization (1, 3, 256) mixed with contrast, or label codes."""
        level: PanoramaLevel = self._pyramids[number].level(height)
        if tables is None:
            return prepare_level(level.color, level.valid)
        return prepare_level(_with_contrast(level.recolored(tables[0]), level, contrast_share), level.valid)


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
