"""The refinement of hypotheses, coarse to fine: on what starts see, on what poses see, and at full resolution.

Paper: §3.3 (refinement of the best candidates).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from panoloc.core.config import LocalizerConfig, StepConfig, StoppingRule
from panoloc.core.decide.hypotheses import Hypothesis, by_map, stacked_poses, with_refined
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.image.level import Level
from panoloc.core.query.map_query import MapQuery, by_colors
from panoloc.core.refine.refinement import halves_apart, joined, refine
from panoloc.core.refine.step import PointPlanes
from panoloc.core.render.comparison import Comparison
from panoloc.core.search.pose_limits import NOTICEABLE_TILT


class Refinement:
    """The steps of refinement of one query."""

    def __init__(self, queries: Sequence[MapQuery], config: LocalizerConfig) -> None:
        self.queries, self.config = queries, config
        limits = queries[0].limits  # of tilts, which are the same in all maps
        self._within = limits.nearest_rotations if limits.bounds_tilts else None

    def coarse(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on what the starts see, at half the rows of a view and at all of them."""
        sizes, refined = self.config.refinement, []
        for rig, group in by_colors(self.queries, hypotheses):
            for half in (True, False):
                rows = self.config.descriptors.view_height // (2 if half else 1)
                level = rig.colors.level(rows, sizes.contrast, blur=half)
                parts = [self.queries[number].points_from_starts(part, half) for number, part in by_map(group)]
                group = self._refine(level, joined(parts), group, 2 * sizes.iterations, sizes.coarse_step, sizes.stop)
            refined += group
        return refined

    def medium(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine on points that the poses themselves see, found anew in each round."""
        sizes, refined = self.config.refinement, []
        for rig, group in by_colors(self.queries, hypotheses):
            for planned in sizes.medium_rounds:
                parts = []
                for number, part in by_map(group):
                    query = self.queries[number]
                    comparison = query.compare(part, rig.rows, with_points=True)
                    parts.append(
                        query.points_from_poses(
                            part, comparison, sizes.medium_points, planned.patch_deg, sizes.contrast / 2
                        )
                    )
                level = rig.colors.level(planned.rows, sizes.contrast / 2)
                step = replace(sizes.step, robust_scale=planned.robust_scale)
                group = self._refine(level, joined(parts), group, sizes.iterations, step, sizes.stop)
            refined += group
        return refined

    def from_beside(self, query: MapQuery, hypothesis: Hypothesis, depth_m: float) -> list[Hypothesis]:
        """Return what a pose comes to from beside it: from nearer, farther, left and right, turned to what it has in its middle.

        Before a wall the loss hardly rises along these ways, so steps may end far from where it is least. depth_m: the distance to what the
        pose shows, metres; each place is as large a share of it away as two steps of focal lengths.
        """
        forward, left, up = (hypothesis.rotation @ query.rig.pyramid.rotations[0]).unbind(1)
        most, beside = 2 * self.config.focal.step, []
        for share in (most, -most):
            ahead = hypothesis.position + share * depth_m * forward
            aside = hypothesis.position + share * depth_m * left
            turn = rotation_from_vector(-math.atan(share) * up)
            beside += [
                replace(hypothesis, position=ahead),
                replace(hypothesis, position=aside, rotation=turn @ hypothesis.rotation),
            ]
        return self.medium(beside)

    def fine(self, query: MapQuery, hypothesis: Hypothesis) -> tuple[Hypothesis, PointPlanes]:
        """Refine at full resolution, with all points and the colours of this pose alone; return these points as well."""
        sizes, rig = self.config.refinement, query.rig
        comparison = self._seen_from(query, hypothesis)
        tables = None if comparison.tables is None else comparison.tables[0]
        for doubled, count in ((1, sizes.fine_points), (2, sizes.finest_points)):
            points = query.points_from_poses(
                [hypothesis], comparison, count, self.config.descriptors.patch_deg, sizes.contrast / 4
            )
            level = rig.colors.level_with(tables, doubled * rig.finer * sizes.fine_rows, sizes.contrast / 4)
            (hypothesis,) = self._refine(level, points, [hypothesis], sizes.iterations, sizes.step, sizes.stop)
        # How sharp the loss of the images is there, limits aside, says how far off the pose may be.
        (there,) = self._refine(level, points, [hypothesis], 1, sizes.step, None)
        return replace(
            there,
            rotation=hypothesis.rotation,
            position=hypothesis.position,
            log_focal=hypothesis.log_focal,
            beyond_limits=self._fits_beyond_limits(query, hypothesis, there, points),
        ), points

    def with_halves(self, query: MapQuery, hypothesis: Hypothesis, points: PointPlanes) -> Hypothesis:
        """Return a hypothesis that was refined fully, with how far apart the halves of the picture end from there among its measures."""
        sizes, described = self.config.refinement, self.config.descriptors
        level = query.rig.colors.level(sizes.medium_rounds[-1].rows, sizes.contrast / 2)
        some = points.thinned(sizes.halves_every)
        focals = query.rig.log_focals([hypothesis])
        apart = halves_apart(level, some, hypothesis.rotation, hypothesis.position, focals, described.patch_deg, sizes)
        distance, angle = apart.tolist()
        measures = {"halves_apart_m": distance, "halves_apart_deg": math.degrees(angle)}
        return replace(hypothesis, measures=hypothesis.measures | measures)

    def _fits_beyond_limits(
        self, query: MapQuery, hypothesis: Hypothesis, there: Hypothesis, points: PointPlanes
    ) -> bool:
        """Return whether the images alone would tilt a pose that was refined fully beyond the limits: a first look, where limits hold it.
        there: what one step without limits comes to."""
        limits, sizes = self.queries[0].limits, self.config.refinement
        if not limits.excess_tilt(there.rotation):
            return False
        level = query.rig.colors.level(sizes.medium_rounds[-1].rows, sizes.contrast / 2)
        some = points.thinned(sizes.halves_every)
        (free,) = self._refine(level, some, [hypothesis], 2 * sizes.iterations, sizes.step, None)
        return limits.excess_tilt(free.rotation) > NOTICEABLE_TILT

    def with_free_focal_length(self, query: MapQuery, hypothesis: Hypothesis, points: PointPlanes) -> Hypothesis:
        """Return where a hypothesis that was refined fully comes to if its focal length is not known: a first look."""
        sizes, free = self.config.refinement, replace(hypothesis, log_focal=0.0)
        level = query.rig.colors.level(query.rig.finer * sizes.fine_rows, sizes.contrast / 4)
        some = points.thinned(sizes.halves_every)
        (there,) = self._refine(level, some, [free], sizes.iterations, sizes.step, sizes.stop)
        return there

    def _seen_from(self, query: MapQuery, hypothesis: Hypothesis) -> Comparison:
        """Return what is seen from a pose, as finely as the scan has points for: a pixel without one aligns nothing."""
        rows = self.config.refinement.fine_rows
        while True:
            comparison = query.compare([hypothesis], rows, with_points=True)
            views = comparison.views
            filled = (views.point >= 0).sum() / views.valid.sum().clamp_min(1)
            if rows <= self.config.descriptors.view_height or float(filled) >= self.config.refinement.least_filled:
                return comparison
            rows //= 2

    def _refine(
        self,
        level: Level,
        points: PointPlanes,
        group: Sequence[Hypothesis],
        iterations: int,
        step: StepConfig,
        stop: StoppingRule | None,
    ) -> list[Hypothesis]:
        """Refine hypotheses of maps that share colours, within the limits of tilts; without a rule to stop, whatever these are."""
        rotations, positions = stacked_poses(group)
        rig = self.queries[group[0].map_number].rig
        numbers = rig.numbers_of([h.map_number for h in group])
        within, focals, bounds = None if stop is None else self._within, rig.log_focals(group), None
        if focals is not None and rig.prior is not None:
            focal = self.config.focal
            bounds, step, iterations = (
                (rig.prior.least, rig.prior.most),
                replace(step, damping=focal.damping),
                2 * iterations,
            )
            if stop and not rig.prior.is_stated:
                # Steps are short all along the valley that pose and focal length share.
                stop = replace(stop, pixels=0.0)
        found = refine(level, points, rotations, positions, iterations, step, stop, numbers, within, focals, bounds)
        return with_refined(group, found)
