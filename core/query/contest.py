"""The poses of one query on their way through refinement and judgement: what earlier ones have come to is not worked out again.

Each judgement discards poses, so that the costly steps see few of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from panoloc.core.camera.rig import Rig
from panoloc.core.config import DISTANCES, LocalizerConfig
from panoloc.core.decide.confidence import ConfidenceModel
from panoloc.core.decide.hypotheses import (
    Accuracy,
    Hypothesis,
    by_map,
    by_score,
    first_and_elsewhere,
    merged,
    with_aliases,
    within_margin,
)
from panoloc.core.query.focal_lengths import (
    FocalPrior,
    contradicts,
    focal_uncertainty,
    leaves_stated,
    with_other_focal_lengths,
)
from panoloc.core.query.map_query import MapQuery
from panoloc.core.query.refinement import Refinement
from panoloc.core.refine.step import PointPlanes
from panoloc.core.render.comparison import Comparison
from panoloc.core.stage_clock import StageClock


@dataclass
class _Full:
    """A hypothesis of the medium stage; itself refined fully and judged, how the scan compares there, and the points that it was refined
    on. tried_beside: whether it was refined from beside it as well."""

    medium: Hypothesis
    final: Hypothesis
    comparison: Comparison
    points: PointPlanes
    tried_beside: bool = False


class Contest:
    """The poses of one query.

    hypotheses: those that are left, best first. comparison: how the scan compares at the best. most_margin: by how much a pose may be
    taken to fit better than others, where only few were looked at.
    """

    def __init__(self, rig: Rig, queries: Sequence[MapQuery], config: LocalizerConfig, clock: StageClock) -> None:
        self.rig = rig
        self.queries, self.config, self.clock = queries, config, clock
        self.refinement = Refinement(queries, config)
        self.hypotheses: list[Hypothesis] = []
        self.comparison: Comparison | None = None
        self._points: PointPlanes | None = None  # that the best was refined on
        self.most_margin: float | None = None
        self._coarse: list[Hypothesis] = []  # by score
        self._medium: list[Hypothesis] = []  # by score
        self._before: list[Hypothesis] = []  # those of the medium stage, as they were before
        self._full: list[_Full] = []
        self._aliases: list[Hypothesis] = []  # where the map says that all looks as at the best
        self._settled_aliases: list[Hypothesis] = []

    def take(self, proposed: Sequence[Hypothesis]) -> None:
        """Take poses in, refined coarsely and judged: rivals of those that are refined further."""
        self._coarse = by_score([*self._coarse, *self._refined_coarse(proposed)], DISTANCES.same)

    def add(self, proposed: Sequence[Hypothesis]) -> None:
        """Take poses in, refine those that may win as far as it takes, and rank all anew."""
        self.take(proposed)
        self.rank()

    def best_score(self) -> float:
        """Return the score of the best pose that was taken in, as of coarse refinement; 0 without one."""
        return self._coarse[0].score if self._coarse else 0.0

    def ranked_score(self) -> float:
        """Return the score of the best pose, as ranked; 0 without one."""
        return self.hypotheses[0].score if self.hypotheses else 0.0

    def is_promising(self, model: ConfidenceModel) -> bool:
        """Return whether the best of the poses that were taken in may be sure in the end."""
        settled = [self._limited(h) for h in self._settle(self._coarse)]
        return any(model.confidence(h, []) >= model.threshold / 2 for h in settled)

    def add_aliases(self, aliases: Sequence[Hypothesis]) -> None:
        """Take in poses from which all of the scan looks as from the best: they go as far as it where they fit hardly worse."""
        self._aliases = [self.hypotheses[0], *aliases]
        least = self._least_of(self._coarse)
        self._settled_aliases = self._settle([h for h in self._refined_coarse(aliases) if h.score >= least])
        self.rank()

    def add_focal_lengths(self) -> None:
        """Let the images contradict a focal length that is stated. Unless it was measured, let poses with others compete with the best;
        anew from the best of them while that is better, and in place of one whose focal length is but a guess. They win against a stated
        one only beyond chance."""
        prior, focal = self.queries[0].rig.prior, self.config.focal
        if not self.hypotheses or self.comparison is None or prior is None:
            return
        best, comparison, losers = self.hypotheses[0], self.comparison, []
        query = self.queries[best.map_number]
        axis = query.rig.pyramid.rotations[0][:, 0]
        free = self._contradicting(query, best, prior) if prior.is_stated else None
        if free is not None:
            others = [h for h in self.hypotheses if not h.is_near(best, DISTANCES.place)]
            losers.append(best)
            best, comparison = self._with_signs(free), free.comparison
            self.hypotheses = [best, *others]
        while not prior.is_measured:  # each time the best fits better than before
            with self.clock.stage("refine"):
                tried = self.refinement.medium(with_other_focal_lengths(best, comparison, prior, axis, focal))
            full = self._best_of(query, tried)
            if full is None:
                break
            is_guess, other = prior.is_guess(best.log_focal), full.final
            is_another = not prior.is_stated or leaves_stated(other, focal, focal.contradiction)
            if not is_guess and not (is_another and other.score > best.score):
                losers += [] if prior.is_as_stated(other.log_focal, focal.step) else [other]
                break
            losers += [] if is_guess else [best]
            best, comparison = self._with_signs(full), full.comparison
        odds = sum(self._odds(loser, best) for loser in losers if not loser.is_near(best, DISTANCES.right))
        best = self._limited(replace(best, measures=best.measures | {"focal_odds": odds}))
        rest = self.hypotheses[1:] if best.log_focal == self.hypotheses[0].log_focal else self.hypotheses
        self.hypotheses, self.comparison = [best, *rest], comparison

    def _odds(self, other: Hypothesis, best: Hypothesis) -> float:
        """Return how many times as probable as the best pose another one is, by their scores. Where one of them has the stated focal
        length, the score of the narrower counts less, as where only bounds are known."""
        rig, ratio = self.queries[best.map_number].rig, other.score / max(best.score, 1e-6)
        if rig.prior is not None and rig.prior.is_stated and (other.log_focal is None) != (best.log_focal is None):
            ratio *= rig.chance_weight(other.log_focal) / rig.chance_weight(best.log_focal)
        return math.pow(max(ratio, 0.0), self.config.focal.power)

    def _contradicting(self, query: MapQuery, best: Hypothesis, prior: FocalPrior) -> _Full | None:
        """Return the best pose with the focal length that the images say it has, None where that may be the stated one."""
        assert self._points is not None
        with self.clock.stage("refine"):
            looked = self.refinement.with_free_focal_length(query, best, self._points)
        if not leaves_stated(looked, self.config.focal, self.config.focal.contradiction / 2):
            return None
        fulls = self._refined_fully([replace(best, log_focal=0.0)])
        return fulls[0] if fulls and contradicts(fulls[0].final, best, prior, self.config.focal) else None

    @property
    def is_guess(self) -> bool:
        """Return whether the focal length of the best pose is but a guess: what it leaves open is known when others have competed."""
        prior = self.queries[0].rig.prior
        return prior is not None and bool(self.hypotheses) and prior.is_guess(self.hypotheses[0].log_focal)

    @property
    def noise(self) -> Accuracy:
        """Return what tracking and an uncertain focal length add to the errors of the best pose.

        A focal length that is a share too long puts the camera so large a share of the distance to what it shows too far away.
        """
        share, best = max(photo.focal_uncertainty for photo in self.rig.photos), self.hypotheses[:1]
        if best and best[0].log_focal is not None:
            share = focal_uncertainty(best[0].information, self.config.focal)
        elif any(photo.hfov_range_deg for photo in self.rig.photos):
            share = self.config.focal.step
        position_m = orientation_deg = 0.0
        if share and self.comparison is not None:
            position_m = share * (self.comparison.depth_m or 0.0)
        if len(self.rig.images) > 1:
            by_position, by_orientation = self.config.judge.tracking_radii
            position_m = math.hypot(position_m, by_position * self.rig.options.position_noise_m)
            orientation_deg = by_orientation * self.rig.options.orientation_noise_deg
        return Accuracy(position_m, orientation_deg)

    def _refined_coarse(self, proposed: Sequence[Hypothesis]) -> list[Hypothesis]:
        with self.clock.stage("refine"):
            refined = self.refinement.coarse(proposed)
        with self.clock.stage("judge"):
            return self._judged(merged(refined, DISTANCES.same), is_first=True)

    def rank(self) -> None:
        """Refine the best of the coarse stage on what they see, and the best of these fully; rank them, and then all others."""
        sizes, place = self.config.refinement, DISTANCES.place
        within = within_margin(self._coarse, sizes.margin)
        self._settle(first_and_elsewhere(self._coarse, len(within), place))
        close = first_and_elsewhere(within_margin(self._medium, sizes.margin), sizes.fine_candidates, place)
        least = self._least_of(self._medium)
        close += [h for h in self._settled_aliases if h.score >= least and all(h is not other for other in close)]
        self._finish(close)
        self.hypotheses = [self._limited(h) for h in self.hypotheses]
        least = self._least_of(self.hypotheses)
        self.hypotheses = with_aliases(self.hypotheses, self._aliases, DISTANCES.elsewhere, least)

    def _limited(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return a hypothesis that fits no better than others by more than it may be taken to."""
        if self.most_margin is None:
            return hypothesis
        return replace(hypothesis, measures=hypothesis.measures | {"most_margin": self.most_margin})

    def _least_of(self, ranked: Sequence[Hypothesis]) -> float:
        """Return the least score of poses that may still win against those that are ranked."""
        return (1 - self.config.refinement.margin) * max((h.score for h in ranked), default=0.0)

    def _settle(self, chosen: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Refine those of the chosen that were not yet on what they see; return these, judged, by score."""
        new = [h for h in chosen if all(h is not other for other in self._before)]
        with self.clock.stage("refine"):
            refined = self.refinement.medium(new)
        with self.clock.stage("judge"):
            allowed = [h for h in self._judged(refined) if self.queries[h.map_number].allows(h)]
        self._before += new
        self._medium = by_score([*self._medium, *allowed], DISTANCES.same)
        return [h for h in allowed if any(h is other for other in self._medium)]

    def _finish(self, chosen: Sequence[Hypothesis]) -> None:
        """Refine poses fully; rank them, and then all others."""
        finals = sorted(self._refined_fully(chosen), key=lambda full: -full.final.score)
        others = [h for h in self._medium if all(h is not other for other in chosen)]
        if not finals:
            self.hypotheses, self.comparison, self._points = [], None, None
            return
        first, place = finals[0].final, DISTANCES.place
        self._refine_from_beside(finals[0])
        best, self.comparison, self._points = self._with_signs(finals[0]), finals[0].comparison, finals[0].points
        ranked = [full.final for full in finals[1:]]
        if not first.is_near(best, DISTANCES.same):  # what steps left there is no rival
            ranked, others = ([h for h in some if not h.is_near(first, place)] for some in (ranked, others))
        if all(h.is_near(best, place) for h in ranked):
            # Margins compare like with like: the best place elsewhere is judged as the best was. Where all others are at the best place,
            # the best of the coarse poses elsewhere is that rival.
            elsewhere = (h for h in (*others, *self._coarse) if not h.is_near(best, place))
            rival = next((h for h in elsewhere if self.queries[h.map_number].allows(h)), None)
            others = [h for h in others if h is not rival]
            if rival is not None:
                with self.clock.stage("judge"):
                    ranked.append(self.queries[rival.map_number].judge_alone(rival)[0])
        # The rest was judged on smaller renderings, where scores are larger: none of it is better than what came before it.
        least = min((h.score for h in ranked if not h.is_near(best, place)), default=math.inf)
        others = [replace(h, score=min(h.score, least)) for h in others]
        self.hypotheses = [best, *ranked, *others]

    def _refine_from_beside(self, full: _Full) -> None:
        """Refine a pose of a narrow rig from beside it, where halves of the images do not agree on it. What fits better takes its place,
        and is refined from beside it in turn."""
        query = self.queries[full.final.map_number]
        while not (query.rig.is_wide or full.tried_beside or full.comparison.depth_m is None):
            if self._with_signs(full).measures["halves_apart_m"] < DISTANCES.same.distance_m:
                return
            full.tried_beside = True
            with self.clock.stage("refine"):
                beside = self.refinement.from_beside(query, full.final, full.comparison.depth_m)
            other = self._best_of(query, beside)
            if other is not None and other.final.score > full.final.score:
                full.final, full.comparison, full.points = other.final, other.comparison, other.points
                full.tried_beside = False

    def _best_of(self, query: MapQuery, refined: Sequence[Hypothesis]) -> _Full | None:
        """Judge poses of the medium stage; return the best that limits allow, refined fully; None where they allow none."""
        with self.clock.stage("judge"):
            allowed = [h for h in self._judged(refined) if query.allows(h)]
        return next(iter(self._refined_fully(allowed[:1])), None)

    def _with_signs(self, full: _Full) -> Hypothesis:
        """Return a hypothesis with what is measured of the best one alone, and only once: how far apart the halves of the images end from
        there."""
        if "halves_apart_m" not in full.final.measures:
            query = self.queries[full.final.map_number]
            with self.clock.stage("refine"):
                full.final = self.refinement.with_halves(query, full.final, full.points)
        return full.final

    def _refined_fully(self, chosen: Sequence[Hypothesis]) -> list[_Full]:
        """Return poses refined at full resolution and judged; each only once in a query."""
        finals = []
        for hypothesis in chosen:
            query = self.queries[hypothesis.map_number]
            known = next((full for full in self._full if full.medium is hypothesis), None)
            if known is None:
                with self.clock.stage("refine"):
                    refined, points = self.refinement.fine(query, hypothesis)
                with self.clock.stage("judge"):
                    known = _Full(hypothesis, *query.judge_alone(refined), points)
                self._full.append(known)
            if query.allows(known.final):
                finals.append(known)
        return finals

    def _judged(self, hypotheses: Sequence[Hypothesis], is_first: bool = False) -> list[Hypothesis]:
        """Return hypotheses by falling score, one for each pose; is_first: of all candidates, on coarse renderings."""
        judged = []
        for number, group in by_map(hypotheses):
            query = self.queries[number]
            judged += query.judge(group, is_first)
        return by_score(judged, DISTANCES.same)
