"""The photos of a session, prepared: their levels and descriptors, made once for all maps that share their colours."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from panoloc.core.camera.rig import Session
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import Hypothesis, stacked_poses
from panoloc.core.features.equalization import LabelCodes, apply_tables
from panoloc.core.features.line_support import LineSupport
from panoloc.core.features.photo_edges import Edges, edges_of_photos
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.image.photo_colors import PhotoContrast, blurred_windows, equalized_windows
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import MAX_SESSION_TILT_DEG
from panoloc.core.refine.photo_points import (
    LookDirections,
    StartViews,
    look_directions,
    points_seen_by_photos,
    points_seen_in_starts,
    views_from_starts,
)
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.rig_level import RigLevel
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.photo_comparison import RigView
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.search.described_photos import DescribedPhotos, describe_photos
from panoloc.core.search.pose_limits import PoseLimits


class PreparedPhotos:
    """Photos as windows of spheres, in the axes of the rig: those of the session, from the middle of its cameras."""

    def __init__(
        self,
        session: Session,
        max_rows: int,
        labels: LabelCodes | None,
        device: torch.device,
        config: LocalizerConfig,
    ) -> None:
        self.labels, self.config = labels, config
        self.atlas = PhotoAtlas(session, max_rows, labels, device)
        self._contrast = PhotoContrast(self.atlas)
        self.share = self.atlas.share()
        self.view = RigView(self.atlas, config.photos.margin_deg)
        self._up_known = session.options.up_known
        self._described: DescribedPhotos | None = None
        self._edges: Edges | None = None
        self._lines: LineSupport | None = None
        self._levels: dict[tuple[int, float, bool], RigLevel] = {}
        self._look: dict[tuple[int, float], LookDirections] = {}
        self._views: dict[int, tuple[dict[int, int], StartViews]] = {}

    def limits_of_rig(self, limits: PoseLimits) -> PoseLimits:
        """Return the limits of the rig's pose where those given are of the first camera."""
        tilt = math.radians(MAX_SESSION_TILT_DEG) if self._up_known else None
        return limits.of_rig(self.atlas.rotations[0], self.atlas.centers[0], tilt)

    def described(self) -> DescribedPhotos:
        """Return the photos' descriptors."""
        if self._described is None:
            config = self.config
            contrast = None if self.labels is not None else self._contrast
            self._described = describe_photos(
                self.atlas, contrast, config.photo_search, config.fine_views, config.descriptors
            )
        return self._described

    def edges(self) -> Edges:
        """Return the edges of the photos."""
        if self._edges is None:
            self._edges = edges_of_photos(self.atlas, self.config.lines)
        return self._edges

    def edges_deg(self) -> float | None:
        """Return how long all edges of the photos are together, degrees; None of labels, whose edges are as sharp as any."""
        return None if self.labels is not None else self.edges().length_deg

    def lines(self) -> LineSupport:
        """Return what the edges of the photos say of how the rig is turned."""
        if self._lines is None:
            self._lines = LineSupport(self.edges(), self.config.lines)
        return self._lines

    def canonical_level(self, height: int, contrast_share: float, blur: bool = False) -> RigLevel:
        """Return a level equalized over all photos and mixed with contrast, prepared for sampling; blurred for the widest basin."""
        key = (height, contrast_share, blur)
        if key not in self._levels:
            windows = self.atlas.windows(height)
            color = windows.color
            if self.labels is None:
                color = self._contrast.mixed(windows, equalized_windows(windows), contrast_share)
            level = windows.level(blurred_windows(color, windows) if blur else color)
            self._levels[key] = RigLevel(level, self.atlas.rotations, self.atlas.centers)
        return self._levels[key]

    def level_for(self, comparison: Comparison, height: int, contrast_share: float) -> RigLevel:
        """Return a level with the colours of the one pose compared: its own equalization mixed with contrast, or label codes."""
        windows = self.atlas.windows(min(height, self.atlas.finest_rows))
        color = windows.color
        if comparison.tables is not None:
            flat = apply_tables(color.flatten(1).T[None], comparison.tables[:1])
            color = self._contrast.mixed(windows, flat[0].T.reshape(color.shape), contrast_share)
        return RigLevel(windows.level(color), self.atlas.rotations, self.atlas.centers)

    def compare(
        self, cloud: RenderCloud, rotations: Tensor, positions: Tensor, height: int, with_points: bool
    ) -> Comparison:
        """Render the cloud at poses, in `height` rows, beside what the photos show."""
        return self.view.compare(cloud, rotations, positions, height, self.labels is not None, with_points)

    def points_from_starts(self, index: MapIndex, group: Sequence[Hypothesis], coarse: bool) -> CandidatePoints:
        """Return what the starts of the hypotheses see where the photos look, with colours of half the views' rows or all."""
        rows, views = self._start_views(index, sorted({h.start for h in group}))
        rotations, positions = stacked_poses(group)
        sizes, photos = self.config.refinement, self.config.photos
        count = photos.coarse_points if self.labels is not None else photos.coarse_points_of(self.share)
        return points_seen_in_starts(
            self.atlas,
            index.render_cloud,
            views,
            torch.tensor([rows[h.start] for h in group], device=rotations.device),
            rotations,
            positions,
            self._look_directions(count, photos.coarse_margin_deg),
            coarse,
            None if self.labels is not None else sizes.contrast_share,
            None if self.labels is not None else photos.rough_patch_deg,
        )

    def points_from_poses(
        self,
        cloud: RenderCloud,
        comparison: Comparison,
        group: Sequence[Hypothesis],
        count: int,
        contrast_share: float,
        pixel_weights: Tensor | None = None,
        patch_deg: float | None = None,
    ) -> CandidatePoints:
        """Return `count` points that the photos show at the compared poses of a group; patch_deg: as of `points_seen_by_photos`."""
        share = None if self.labels is not None else contrast_share
        look = self._look_directions(count, self.config.photos.margin_deg)
        return points_seen_by_photos(
            self.view, cloud, comparison, *stacked_poses(group), look, share, pixel_weights, patch_deg
        )

    def _look_directions(self, count: int, margin_deg: float) -> LookDirections:
        key = (count, margin_deg)
        if key not in self._look:
            self._look[key] = look_directions(self.atlas, count, margin_deg)
        return self._look[key]

    def _start_views(self, index: MapIndex, starts: Sequence[int]) -> tuple[dict[int, int], StartViews]:
        """Return the row of each start in the views, and the views, rendered once per map."""
        known = self._views.get(id(index))
        if known is None or not known[0].keys() >= set(starts):
            chosen = torch.tensor(list(starts), device=index.starts.device)
            views = views_from_starts(index, chosen, self.config.refinement.start_view_height)
            known = {start: row for row, start in enumerate(starts)}, views
            self._views[id(index)] = known
        return known
