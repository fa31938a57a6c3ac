"""Which hypotheses remain."""

import math

import pytest
import torch

from panoloc.core.config import DISTANCES, PoseDistance
from panoloc.core.decide.hypotheses import (
    Hypothesis,
    by_score,
    first_and_elsewhere,
    merged,
    with_aliases,
    with_refined,
    within_margin,
)
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.refine.refinement import Refined
from tests.core.found_pose import known


def placed(x: float, score: float = 0.0, loss: float = 0.0, map_number: int = 0) -> Hypothesis:
    """Return a hypothesis `x` metres along an axis."""
    return Hypothesis(map_number, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), score=score, loss=loss)


def test_of_candidates_that_met_the_one_of_smallest_loss_stays() -> None:
    met = [placed(0.0, loss=0.3), placed(0.05, loss=0.1), placed(1.0, loss=0.2), placed(0.05, map_number=1)]
    found = merged(met, PoseDistance(0.1, 3.0))
    assert [(h.map_number, h.loss) for h in found] == [(1, 0.0), (0, 0.1), (0, 0.2)]


def test_hopeless_candidates_go() -> None:
    ranked = [placed(0.0, 1.4), placed(0.2, 1.3), placed(5.0, 0.6), placed(9.0, 0.5)]
    assert [h.score for h in within_margin(ranked, 0.35)] == [1.4, 1.3]
    assert within_margin([], 0.35) == []


def test_hypotheses_that_converged_to_one_pose_count_once() -> None:
    near = [Hypothesis(0, k, torch.eye(3), torch.tensor([0.01 * k, 0, 0]), score=0.5 + 0.1 * k) for k in range(4)]
    apart = Hypothesis(0, 9, torch.eye(3), torch.tensor([2.0, 0, 0]), score=0.1)
    elsewhere = Hypothesis(1, 0, torch.eye(3), torch.zeros(3), score=0.2)
    kept = by_score([*near, apart, elsewhere], DISTANCES.same)
    assert [h.score for h in kept] == [near[3].score, 0.2, 0.1]


@pytest.mark.parametrize(
    ("distance_m", "angle_deg", "is_near"),
    [(0.4, 14.0, True), (0.5, 0.0, False), (0.6, 0.0, False), (0.0, 16.0, False), (0.4, 16.0, False)],
)
def test_two_hypotheses_are_near_when_both_place_and_orientation_are(
    distance_m: float, angle_deg: float, is_near: bool
) -> None:
    turned = rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(angle_deg)]))
    one = placed(0.0)
    other = Hypothesis(0, 3, turned, torch.tensor([0.0, distance_m, 0.0]))
    assert one.is_near(other, PoseDistance(0.5, 15.0)) is is_near
    assert other.is_near(one, PoseDistance(0.5, 15.0)) is is_near
    elsewhere = Hypothesis(1, 3, torch.eye(3), torch.zeros(3))
    assert not one.is_near(elsewhere, PoseDistance(0.5, 15.0))


def test_refinement_changes_the_pose_and_what_is_known_of_it_and_nothing_else() -> None:
    group = [
        Hypothesis(
            2, k, torch.eye(3), torch.zeros(3), score=0.1 * k, iterations=k, color_model="x", log_focal=log_focal
        )
        for k, log_focal in enumerate((None, None, 0.0))
    ]
    refined = Refined(
        numbers=torch.tensor([0, 2]),
        rotations=torch.stack([rotation_from_vector(torch.tensor([0.0, 0.0, a])) for a in (0.1, 0.2)]),
        positions=torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        loss=torch.tensor([0.25, 0.5]),
        hessian=torch.stack((torch.eye(6), 2 * torch.eye(6))),
        scale=torch.tensor([0.125, 0.75]),
        steps=torch.tensor([7, 9]),
        log_focals=torch.tensor([-0.0625, 0.375]),
        information=torch.tensor([0.5, 2.0]),
    )
    found = with_refined(group, refined)
    assert [h.start for h in found] == [0, 2]  # the second had come together with one of these
    for k, (one, before) in enumerate(zip(found, (group[0], group[2]), strict=True)):
        assert torch.equal(one.rotation, refined.rotations[k])
        assert torch.equal(one.position, refined.positions[k])
        assert torch.equal(known(one.hessian), refined.hessian[k])
        assert (one.loss, one.residual_scale) == (float(refined.loss[k]), float(refined.scale[k]))
        log_focal = None if before.log_focal is None else float(refined.log_focals[k])  # a known one stays known
        assert (one.log_focal, one.information) == (log_focal, float(refined.information[k]))
        assert one.iterations == before.iterations + int(refined.steps[k])
        assert (one.map_number, one.score, one.color_model) == (2, before.score, "x")


def test_the_first_are_kept_and_the_best_one_elsewhere() -> None:
    best, beside, elsewhere = placed(0.0, 1.0), placed(0.2, 0.98), placed(3.0, 0.9)
    others = [placed(0.3, 0.8), placed(6.0, 0.7)]
    assert first_and_elsewhere([best, beside, elsewhere, *others], 2, DISTANCES.place) == [best, beside, elsewhere]
    assert first_and_elsewhere([best, elsewhere, beside, *others], 2, DISTANCES.place) == [best, elsewhere]
    assert first_and_elsewhere([best, beside, others[0]], 2, DISTANCES.place) == [best, beside]
    assert first_and_elsewhere([], 2, DISTANCES.place) == []


def test_places_near_those_that_look_the_same_are_marked_and_the_best_is_not() -> None:
    hypotheses = [placed(0.0), placed(4.1), placed(9.0), placed(4.0, map_number=1)]
    marked = with_aliases(hypotheses, [placed(4.5), placed(0.1)], PoseDistance(1.0, 30.0), 0.0)
    assert [h.is_alias for h in marked] == [False, True, False, False]
    assert with_aliases([], [placed(0.0)], PoseDistance(1.0, 30.0), 0.0) == []


def test_what_is_near_the_best_is_no_equal_however_near_it_is_to_one() -> None:
    # 0.8 m beside the best, and as far from a place that looks the same.
    hypotheses = [placed(0.0), placed(0.8), placed(1.7)]
    marked = with_aliases(hypotheses, [placed(0.0), placed(1.6)], PoseDistance(1.0, 30.0), 0.0)
    assert [h.is_alias for h in marked] == [False, False, True]


def test_the_place_that_equals_were_sought_from_is_one_of_them_where_another_fits_better() -> None:
    sought_from, equal = placed(0.0), placed(4.5)
    ranked = [placed(4.4, 0.9), placed(0.1, 0.8), placed(9.0, 0.7)]
    marked = with_aliases(ranked, [sought_from, equal], PoseDistance(1.0, 30.0), 0.0)
    assert [h.is_alias for h in marked] == [False, True, False]
    assert not any(h.is_alias for h in with_aliases(ranked, [sought_from, equal], PoseDistance(1.0, 30.0), 0.81))
    # What is best at none of these places says nothing of them.
    elsewhere = [placed(9.0, 0.9), placed(0.1, 0.8), placed(4.4, 0.7)]
    marked = with_aliases(elsewhere, [sought_from, equal], PoseDistance(1.0, 30.0), 0.0)
    assert not any(h.is_alias for h in marked)
