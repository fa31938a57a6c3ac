"""The refinement steps of the `fast` method: on what starts see, on what poses see, and at full resolution."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from panoloc.core.config import LocalizerConfig, StepConfig, StoppingRule
from panoloc.core.decide.hypotheses import Hypothesis, by_map, stacked_poses, with_refined
from panoloc.core.fast.candidates import most_promising
from panoloc.core.image.image_level import ImageLevel
from panoloc.core.prepared_panorama import PreparedPanorama
from panoloc.core.prepared_photos import PreparedPhotos
from panoloc.core.prepared_query import MapQuery, by_colors, within_limits
from panoloc.core.refine.focal_refinement import FocalRefined, refine_with_focal
from panoloc.core.refine.halves import halves_apart
from panoloc.core.refine.refinement import CandidatePoints, joined, refine
from panoloc.core.refine.rig_level import RigLevel
from panoloc.core.stage_clock import StageClock


class RefinementSteps:
    """The refinement steps of one query."""

    def __init__(self, config: LocalizerConfig, clock: StageClock) -> None:
        self.config, self.clock = config, clock

    def on_starts(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on what the starts see, at half the rows of a view and at all of them."""
        sizes, refined = self.config.refinement, []
        for picture, group in by_colors(queries, hypotheses):
            for coarse, iterations in zip((True, False), sizes.coarse_iterations, strict=True):
                height = sizes.start_view_height // (2 if coarse else 1)
                level = picture.canonical_level(height, sizes.contrast_share, blur=coarse)
                points = joined([queries[number].points_from_starts(part, coarse) for number, part in by_map(group)])
                step = self._rough_step() if points.patches is None else self.config.photos.rough_patch_step
                group = self._refine(picture, level, points, group, iterations, sizes.coarse_stop, step)
                if coarse and points.patches is not None:
                    group = most_promising(group, self.config.photos)
            refined += within_limits(queries, group)
        return refined

    def on_poses(self, queries: Sequence[MapQuery], hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on points that the poses themselves see, found anew in each round as what a pose sees changes with it."""
        sizes, refined = self.config.refinement, []
        for picture, group in by_colors(queries, hypotheses):
            if isinstance(picture, PreparedPhotos) and picture.labels is None:
                refined += self._by_patches(queries, picture, group)
                continue
            for rows, scale in sizes.middle_rounds:
                points = joined([queries[number].points_from_poses(part) for number, part in by_map(group)])
                level = picture.canonical_level(rows, sizes.contrast_share)
                step = replace(self.config.step, robust_scale=scale)
                group = self._refine(picture, level, points, group, sizes.middle_iterations, sizes.middle_stop, step)
                group = within_limits(queries, group)
            refined += group
        return refined

    def _by_patches(
        self, queries: Sequence[MapQuery], picture: PreparedPhotos, group: Sequence[Hypothesis]
    ) -> list[Hypothesis]:
        """Refine patch by patch on points that the poses themselves see, found anew in each round."""
        sizes, photos = self.config.refinement, self.config.photos
        for rows, patch_deg, scale in photos.patch_rounds:
            points = joined([queries[number].points_by_patches(part, patch_deg) for number, part in by_map(group)])
            level = picture.canonical_level(rows, photos.patch_contrast_share)
            step = replace(photos.patch_step, patch_robust_scale=scale)
            group = self._refine(picture, level, points, group, sizes.middle_iterations, sizes.middle_stop, step)
            group = within_limits(queries, group)
        return list(group)

    def _rough_step(self) -> StepConfig:
        """Return the steps from the starts."""
        sizes, step = self.config.refinement, self.config.step
        if sizes.rough_damping is None or sizes.rough_max_relaxation is None:
            return step
        return replace(step, damping=sizes.rough_damping, relaxation=1.0, max_relaxation=sizes.rough_max_relaxation)

    def fully(self, query: MapQuery, hypothesis: Hypothesis) -> tuple[Hypothesis, CandidatePoints]:
        """Refine at full resolution, with all points and the colours of this pose alone; return these points as well."""
        self.clock.check()
        sizes, share = self.config.refinement, self.config.refinement.fine_contrast_share
        comparison = query.compare([hypothesis], sizes.visibility_height, with_points=True)
        for height, count, iterations in (
            (sizes.fine_height, sizes.fine_points, sizes.fine_iterations),
            (sizes.finest_height, sizes.finest_points, sizes.finest_iterations),
        ):
            points = query.full_points(hypothesis, comparison, count)
            level = query.picture.level_for(comparison, height, share)
            step = None if points.patches is None else self.config.photos.patch_step
            (hypothesis,) = self._refine(query.picture, level, points, [hypothesis], iterations, sizes.fine_stop, step)
        if points.patches is not None:
            # How sharp the loss of single points is there says how far off the pose may be.
            (there,) = self._refine(query.picture, level, replace(points, patches=None), [hypothesis], 1, None)
            hypothesis = replace(there, rotation=hypothesis.rotation, position=hypothesis.position)
        return query.within_limits(hypothesis), points

    def with_halves(self, query: MapQuery, hypothesis: Hypothesis, points: CandidatePoints) -> Hypothesis:
        """Return a hypothesis that was refined fully, with how far apart the halves of the picture end from there among its measures."""
        sizes, photos = self.config.refinement, self.config.photos
        share = sizes.contrast_share if points.patches is None else photos.patch_contrast_share
        level = query.picture.canonical_level(sizes.halves.rows, share)
        step = self._suited(query.picture, self.config.step if points.patches is None else photos.patch_step)
        apart = halves_apart(level, points, hypothesis.rotation, hypothesis.position, step, sizes.halves)
        distance, angle = apart.tolist()
        return replace(
            hypothesis,
            measures=hypothesis.measures | {"halves_apart_m": distance, "halves_apart_deg": math.degrees(angle)},
        )

    def focal_pull(self, query: MapQuery, hypothesis: Hypothesis, points: CandidatePoints) -> float:
        """Return how strongly photos pull the focal length away from what it is said to be, where a pose was refined fully."""
        photos = self.config.photos
        level = query.picture.canonical_level(photos.focal_rows[0], photos.patch_contrast_share)
        assert isinstance(level, RigLevel)
        begun, some = FocalRefined.at(hypothesis.rotation, hypothesis.position), points.thinned(photos.pull_every)
        return refine_with_focal(level, some, begun, photos.pull_iterations, photos.patch_step).strength

    def with_focal(self, query: MapQuery, hypothesis: Hypothesis) -> FocalRefined:
        """Refine a pose of photos together with their focal length."""
        self.clock.check()
        sizes, photos = self.config.refinement, self.config.photos
        found = FocalRefined.at(hypothesis.rotation, hypothesis.position)
        for rows in photos.focal_rows:
            hypothesis = replace(hypothesis, rotation=found.rotation, position=found.position)
            comparison = query.compare([hypothesis], sizes.visibility_height, with_points=True)
            points = query.points_with_patches(hypothesis, comparison)
            level = query.picture.canonical_level(rows, photos.patch_contrast_share)
            assert isinstance(level, RigLevel)
            step = self._suited(query.picture, photos.patch_step)
            found = refine_with_focal(level, points, found, photos.focal_iterations, step)
        return found

    def _refine(
        self,
        picture: PreparedPanorama | PreparedPhotos,
        level: ImageLevel | RigLevel,
        points: CandidatePoints,
        group: Sequence[Hypothesis],
        iterations: int,
        stop: StoppingRule | None,
        step: StepConfig | None = None,
    ) -> list[Hypothesis]:
        """Refine hypotheses of maps that share colours; step: None for that of the configuration."""
        step = self._suited(picture, step or self.config.step)
        rotations, positions = stacked_poses(group)
        maps = torch.tensor([h.map_number for h in group], device=rotations.device)
        return with_refined(group, refine(level, points, rotations, positions, iterations, step, stop, maps))

    def _suited(self, picture: PreparedPanorama | PreparedPhotos, step: StepConfig) -> StepConfig:
        """Return the step for the colours of a picture: those of labels have no light."""
        return step if picture.labels is None else step.for_labels()
