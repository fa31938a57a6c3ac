"""Poses on their way: nothing is worked out twice, and margins compare like with like."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest
import torch

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import NO_NOISE, Hypothesis
from panoloc.core.query.contest import Contest
from panoloc.core.query.focal_lengths import FocalPrior
from panoloc.core.search.pose_limits import PoseLimits
from panoloc.core.stage_clock import StageClock
from tests.core.image.painted_photos import UPRIGHT, photo_of, session_of

PHOTO = Rig.of_photo(photo_of(UPRIGHT))
UNSURE = Rig.of_photo(replace(PHOTO.photos[0], focal_uncertainty=0.02))
DEPTH_M = 2.0  # of what a pose shows
SMALLER = 0.5  # what is judged on the largest rendering has half the score


def placed(x: float, score: float, log_focal: float = 0.0, information: float = 50.0) -> Hypothesis:
    """Return a hypothesis `x` metres along an axis, whose images tell the focal length to 1 percent."""
    at = torch.tensor([x, 0.0, 0.0])
    return Hypothesis(0, 0, torch.eye(3), at, score=score, log_focal=log_focal, information=information)


class Refinement:
    """Stands for the steps of refinement: leaves poses as they are, but for what the medium stage `moves`, and counts them; `freed` is what
    the best comes to if its focal length is not known, `beside` what poses at some places come to from beside them,
    which halves of the images do not agree on."""

    def __init__(
        self, moves: dict[float, float], freed: Hypothesis | None, beside: dict[float, list[Hypothesis]] | None
    ) -> None:
        self.moves, self.freed, self.beside = moves, freed, beside
        self.seen: dict[str, list[Hypothesis]] = {name: [] for name in ("coarse", "medium", "beside", "fine", "halves")}

    def coarse(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        self.seen["coarse"] += hypotheses
        return list(hypotheses)

    def medium(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        self.seen["medium"] += hypotheses
        return [self._moved(h) for h in hypotheses]

    def from_beside(self, query: Any, hypothesis: Hypothesis, depth_m: float) -> list[Hypothesis]:
        assert depth_m == DEPTH_M
        self.seen["beside"].append(hypothesis)
        return (self.beside or {}).get(round(float(hypothesis.position[0]), 3), [])

    def fine(self, query: Any, hypothesis: Hypothesis) -> tuple[Hypothesis, Any]:
        self.seen["fine"].append(hypothesis)
        if self.freed is not None and "halves_apart_m" in hypothesis.measures:
            hypothesis = self.freed
        return hypothesis, SimpleNamespace(of_score=hypothesis.score)

    def with_free_focal_length(self, query: Any, hypothesis: Hypothesis, points: Any) -> Hypothesis:
        assert points.of_score == hypothesis.score / SMALLER
        return self.freed or hypothesis

    def with_halves(self, query: Any, hypothesis: Hypothesis, points: Any) -> Hypothesis:
        self.seen["halves"].append(hypothesis)
        assert points.of_score == hypothesis.score / SMALLER
        apart_m = 0.01 if self.beside is None else 0.2
        return replace(hypothesis, measures=hypothesis.measures | {"halves_apart_m": apart_m, "halves_apart_deg": 0.1})

    def _moved(self, hypothesis: Hypothesis) -> Hypothesis:
        x = round(float(hypothesis.position[0]), 3)
        return replace(hypothesis, position=torch.tensor([self.moves[x], 0, 0])) if x in self.moves else hypothesis


@pytest.fixture(autouse=True)
def other_focal_lengths(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the comparisons of these tests say where a camera would stand with other focal lengths."""
    steps = "panoloc.core.query.contest.with_other_focal_lengths"
    monkeypatch.setattr(steps, lambda best, comparison, *known: comparison.others(best.log_focal))


def contest_of(
    allows: Callable[[Hypothesis], bool] = lambda hypothesis: True,
    moves: dict[float, float] | None = None,
    rig: Rig = PHOTO,
    others: Callable[[float], list[Hypothesis]] = lambda log_focal: [],
    freed: Hypothesis | None = None,
    is_measured: bool = False,
    beside: dict[float, list[Hypothesis]] | None = None,
    is_wide: bool = False,
    weight: Callable[[float | None], float] = lambda log_focal: 1.0,
) -> tuple[Contest, dict[str, list[Hypothesis]]]:
    """Return a contest in one map, whose judge halves scores at the end; and what each stage of refinement has seen."""

    def judge_alone(hypothesis: Hypothesis) -> tuple[Hypothesis, Any]:
        comparison = SimpleNamespace(of=hypothesis, others=others, depth_m=DEPTH_M)
        return replace(hypothesis, score=SMALLER * hypothesis.score), comparison

    query: Any = SimpleNamespace(
        judge=lambda group, is_first: list(group),
        judge_alone=judge_alone,
        allows=allows,
        limits=PoseLimits(),
        rig=SimpleNamespace(
            finer=1,
            rows=64,
            patch_deg=22.5,
            share=1.0,
            is_wide=is_wide,
            prior=FocalPrior(-0.1, 0.8, True, is_measured),
            chance_weight=weight,
            pyramid=SimpleNamespace(rotations=torch.eye(3)[None]),
        ),
    )
    config = LocalizerConfig()
    contest = Contest(rig, [query], config, StageClock(None, torch.device("cpu")))
    refinement = Refinement(moves or {}, freed, beside)
    contest.refinement = cast(Any, refinement)
    return contest, refinement.seen


def found_by(contest: Contest) -> list[tuple[float, float]]:
    """Return where the hypotheses of a contest are, and their scores, best first."""
    return [(round(float(h.position[0]), 2), round(h.score, 3)) for h in contest.hypotheses]


def test_what_was_refined_at_a_stage_is_not_again() -> None:
    contest, seen = contest_of()
    ranked = [placed(0.0, 1.0), placed(3.0, 0.8), placed(6.0, 0.7)]
    contest.add(ranked[:2])
    contest.add(ranked[2:])
    assert seen["coarse"] == seen["medium"] == ranked
    assert seen["fine"] == ranked[:2]
    assert [h.score for h in seen["halves"]] == [0.5]
    assert cast(Any, contest.comparison).of is ranked[0]


def test_a_pose_without_a_rival_is_alone_and_nothing_elsewhere_bounds_the_others_there() -> None:
    contest, seen = contest_of()
    contest.add([placed(0.0, 1.0), placed(0.2, 0.9), placed(0.4, 0.8)])
    assert len(seen["fine"]) == 2
    assert found_by(contest) == [(0.0, 0.5), (0.2, 0.45), (0.4, 0.8)]


def test_the_best_rival_is_judged_as_the_best_is_and_what_is_not_counts_no_more_than_it() -> None:
    contest, _ = contest_of(moves={0.2: 0.3})
    contest.add([placed(0.0, 1.0), placed(0.2, 0.9), placed(3.0, 0.8), placed(6.0, 0.7)])
    assert found_by(contest) == [(0.0, 0.5), (0.3, 0.45), (3.0, 0.4), (6.0, 0.4)]


def test_where_all_came_to_one_place_the_best_that_was_elsewhere_before_is_the_rival() -> None:
    contest, _ = contest_of(moves={3.0: 0.05})
    contest.add([placed(0.0, 1.0), placed(0.3, 0.9), placed(3.0, 0.6), placed(6.0, 0.5)])
    assert found_by(contest) == [(0.0, 0.5), (0.3, 0.45), (3.0, 0.3)]


def test_a_rival_that_was_refined_fully_is_not_judged_once_more_as_it_was_before() -> None:
    contest, _ = contest_of()
    contest.add([placed(0.0, 1.0), placed(3.0, 0.9)])
    assert found_by(contest) == [(0.0, 0.5), (3.0, 0.45)]


def test_what_limits_do_not_allow_is_no_answer_however_well_it_fits() -> None:
    contest, seen = contest_of(allows=lambda h: float(h.position[0]) < 5)
    contest.add([placed(6.0, 1.0)])
    assert contest.hypotheses == seen["fine"] == []
    assert contest.comparison is None
    contest.add([placed(0.0, 0.9)])
    assert found_by(contest)[0] == (0.0, 0.45)


def test_aliases_of_the_best_go_as_far_as_it_where_they_fit_hardly_worse() -> None:
    contest, seen = contest_of()
    contest.add([placed(0.0, 1.0), placed(3.0, 0.9)])
    alias, unlike = placed(6.0, 0.7), placed(9.0, 0.6)
    contest.add_aliases([alias, unlike])
    assert any(h is alias for h in seen["fine"])
    assert all(h is not unlike for h in seen["medium"])
    marked = {round(float(h.position[0])): h.is_alias for h in contest.hypotheses}
    assert marked == {0: False, 3: False, 6: True}


# From beside the best.


def test_what_fits_better_from_beside_the_best_takes_its_place_for_good() -> None:
    ways = {0.0: [placed(0.4, 1.1), placed(0.3, 1.05)], 0.4: [placed(0.8, 1.2)], 0.8: [placed(1.2, 1.15)]}
    contest, seen = contest_of(beside=ways)
    # What is near where it was is no rival: it stayed behind.
    contest.add([placed(0.0, 1.0), placed(-0.2, 0.9), placed(3.0, 0.9)])
    assert found_by(contest) == [(0.8, 0.6), (3.0, 0.45)]
    assert cast(Any, contest.comparison).of.score == 1.2
    assert [round(float(h.position[0]), 1) for h in seen["beside"]] == [0.0, 0.4, 0.8]
    contest.add([placed(5.0, 0.8)])
    assert found_by(contest)[0] == (0.8, 0.6)
    assert len(seen["beside"]) == 3


def test_where_halves_of_the_images_agree_nothing_is_refined_anew() -> None:
    contest, seen = contest_of()
    contest.add([placed(0.0, 1.0)])
    assert (len(seen["halves"]), seen["beside"]) == (1, [])


def test_from_beside_the_best_what_fits_best_of_what_limits_allow_is_taken() -> None:
    ways = {0.0: [placed(0.6, 1.3), placed(0.3, 1.1)]}
    contest, _ = contest_of(beside=ways, allows=lambda h: float(h.position[0]) < 0.4)
    contest.add([placed(0.0, 1.0)])
    assert found_by(contest) == [(0.3, 0.55)]


def test_rigs_that_see_all_around_are_not_refined_from_beside() -> None:
    contest, seen = contest_of(beside={0.0: [placed(0.4, 1.1)]}, is_wide=True)
    contest.add([placed(0.0, 1.0)])
    assert (found_by(contest), seen["beside"]) == ([(0.0, 0.5)], [])


# Other focal lengths.

POWER = LocalizerConfig().focal.power


def test_a_pose_with_another_focal_length_that_fits_less_well_is_a_rival_as_probable_as_its_score_says() -> None:
    contest, seen = contest_of(others=lambda log_focal: [placed(1.0, 0.96, 0.3), placed(2.0, 0.5, 0.6)])
    contest.add([placed(0.0, 1.0), placed(3.0, 0.9)])
    contest.add_focal_lengths()
    assert found_by(contest) == [(0.0, 0.5), (3.0, 0.45)]
    assert contest.hypotheses[0].measures["focal_odds"] == pytest.approx(0.96**POWER)
    assert [h.log_focal for h in seen["fine"]] == [0.0, 0.0, 0.3]  # of the others the best alone


@pytest.mark.parametrize(("is_measured", "count"), [(True, 0), (False, 1)])
def test_a_focal_length_that_the_images_contradict_is_a_rival_and_a_measured_one_is_sought_no_further(
    is_measured: bool, count: int
) -> None:
    asked: list[float] = []

    def others(log_focal: float) -> list[Hypothesis]:
        asked.append(log_focal)
        return []

    freed = replace(placed(1.0, 0.97, 0.3), information=2.0)
    contest, _ = contest_of(others=others, freed=freed, is_measured=is_measured)
    contest.most_margin = 0.35
    contest.add([placed(0.0, 1.0), placed(0.3, 0.9), placed(3.0, 0.9)])
    contest.add_focal_lengths()
    assert found_by(contest) == [(1.0, 0.485), (3.0, 0.45)]
    assert contest.hypotheses[0].measures["most_margin"] == 0.35
    assert contest.hypotheses[0].measures["focal_odds"] == pytest.approx((1.0 / 0.97) ** POWER)
    assert "halves_apart_m" in contest.hypotheses[0].measures
    assert asked == [0.3] * count


@pytest.mark.parametrize(("log_focal", "weight"), [(0.3, 0.8), (-0.1, 1.1)])
def test_where_one_of_two_focal_lengths_is_stated_an_image_that_would_show_more_counts_more(
    log_focal: float, weight: float
) -> None:
    weights = {None: 1.0, log_focal: weight}
    freed = replace(placed(1.0, 1.05, log_focal), information=99.0)
    contest, _ = contest_of(freed=freed, is_measured=True, weight=weights.__getitem__)
    contest.add([replace(placed(0.0, 1.0), log_focal=None)])
    contest.add_focal_lengths()
    assert contest.hypotheses[0].log_focal == log_focal
    assert contest.hypotheses[0].measures["focal_odds"] == pytest.approx((1 / (1.05 * weight)) ** POWER)


def test_the_best_is_refined_no_further_where_a_first_look_leaves_its_focal_length_as_it_is() -> None:
    contest, seen = contest_of(freed=replace(placed(1.0, 0.97, 0.04), information=2.0), is_measured=True)
    contest.add([placed(0.0, 1.0)])
    contest.add_focal_lengths()
    assert (found_by(contest), len(seen["fine"])) == ([(0.0, 0.5)], 1)


def test_at_the_same_place_another_focal_length_is_no_rival() -> None:
    contest, _ = contest_of(others=lambda log_focal: [placed(0.1, 0.96, 0.3)])
    contest.add([placed(0.0, 1.0)])
    contest.add_focal_lengths()
    assert contest.hypotheses[0].measures["focal_odds"] == 0.0


@pytest.mark.parametrize(
    ("score", "information", "log_focal", "odds"),
    [(1.2, 50.0, 0.07, 1.2**-25), (0.99, 50.0, 0.0, 0.0), (1.2, 10.0, 0.0, 0.0)],
    ids=["fits better", "fits worse", "within what images leave open"],
)
def test_a_focal_length_that_is_hardly_another_is_one_only_where_it_fits_better_and_beyond_chance(
    score: float, information: float, log_focal: float, odds: float
) -> None:
    contest, _ = contest_of(others=lambda log_focal: [placed(1.0, score, 0.07, information)])
    contest.add([placed(0.0, 1.0)])
    contest.add_focal_lengths()
    best = contest.hypotheses[0]
    assert best.log_focal == log_focal
    assert best.measures["focal_odds"] == pytest.approx(odds)


def test_the_focal_length_that_fits_best_wins_also_where_it_is_come_to_by_way_of_another() -> None:
    ways = {0.0: [placed(1.0, 1.1, 0.3)], 0.3: [placed(2.0, 1.2, 0.6)], 0.6: [placed(2.5, 1.15, 0.5)]}
    contest, _ = contest_of(others=lambda log_focal: ways[log_focal])
    contest.add([placed(0.0, 1.0), placed(3.0, 0.9)])
    contest.add_focal_lengths()
    assert found_by(contest)[:2] == [(2.0, 0.6), (0.0, 0.5)]
    best = contest.hypotheses[0]
    assert best.log_focal == 0.6
    assert cast(Any, contest.comparison).of.log_focal == 0.6
    assert "halves_apart_m" in best.measures
    odds = sum((score / 1.2) ** POWER for score in (1.0, 1.1, 1.15))
    assert best.measures["focal_odds"] == pytest.approx(odds)


def test_what_limits_do_not_allow_is_no_focal_length_either() -> None:
    contest, _ = contest_of(allows=lambda h: float(h.position[0]) < 1, others=lambda log_focal: [placed(1.5, 1.2, 0.3)])
    contest.add_focal_lengths()
    assert contest.hypotheses == []
    contest.add([placed(0.0, 1.0)])
    contest.add_focal_lengths()
    assert (contest.hypotheses[0].log_focal, contest.hypotheses[0].measures["focal_odds"]) == (0.0, 0.0)


def test_a_focal_length_that_is_known_has_no_rivals() -> None:
    contest, _ = contest_of(others=lambda log_focal: [placed(1.0, 1.2, 0.3)])
    cast(Any, contest.queries[0]).rig.prior = None
    contest.add([placed(0.0, 1.0)])
    contest.add_focal_lengths()
    assert contest.hypotheses[0].log_focal == 0.0


# Signs and noise of the best.


def test_of_the_best_alone_the_halves_are_measured() -> None:
    contest, _ = contest_of()
    contest.add([placed(0.0, 1.0), placed(3.0, 0.9)])
    best, *others = contest.hypotheses
    assert best.measures == {"halves_apart_m": 0.01, "halves_apart_deg": 0.1}
    assert all(other.measures == {} for other in others)


def test_the_noise_of_a_photo_is_the_share_of_its_focal_length_times_the_distance_to_what_it_shows() -> None:
    assert contest_of()[0].noise == NO_NOISE
    contest, _ = contest_of(rig=UNSURE)
    assert contest.noise == NO_NOISE  # of no pose
    contest.comparison = cast(Any, SimpleNamespace(depth_m=DEPTH_M))
    assert contest.noise.position_m == pytest.approx(0.02 * DEPTH_M)
    assert contest.noise.orientation_deg == 0.0
    contest.comparison = cast(Any, SimpleNamespace(depth_m=None))
    assert contest.noise == NO_NOISE


@pytest.mark.parametrize(("information", "share"), [(1.0, 0.07), (25.0, 0.014)])
def test_a_focal_length_that_was_found_is_as_uncertain_as_the_images_leave_it(information: float, share: float) -> None:
    found = replace(placed(1.0, 1.2, 0.3), information=information)
    contest, _ = contest_of(rig=UNSURE, others=lambda log_focal: [found] if not log_focal else [])
    contest.add([placed(0.0, 1.0)])
    contest.add_focal_lengths()
    assert contest.noise.position_m == pytest.approx(share * DEPTH_M)


def test_the_noise_of_several_images_is_that_of_their_tracking() -> None:
    session = session_of()
    options = replace(session.options, position_noise_m=0.04, orientation_noise_deg=2.0)
    contest, _ = contest_of(rig=replace(session, options=options))
    by_position, by_orientation = contest.config.judge.tracking_radii
    assert contest.noise.position_m == pytest.approx(0.04 * by_position)
    assert contest.noise.orientation_deg == pytest.approx(2.0 * by_orientation)
