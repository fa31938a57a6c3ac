"""Refinement, judge, confidence and colour models on inputs with known answers."""

import math

import numpy as np
import pytest
import torch

from core.config import Rest
from core.geometry.pose import Pose
from core.geometry.projection import pixel_directions
from core.geometry.rotations import rotation_angle, rotation_from_vector, uniform_rotations
from core.index.map_index import MapIndex
from core.judge.agreement import agreement
from core.judge.confidence import (
    FEATURES,
    ConfidenceModel,
    RadiusModel,
    error_radii,
    formal_radii,
    load_confidence_model,
)
from core.judge.hypotheses import Hypothesis, best_distinct, converged, promising
from core.light.color_equalization import label_codes
from core.light.light_fit import fit_gain_offset
from core.panorama.image_level import prepare_level
from core.panorama.panorama import Panorama
from core.panorama.pyramid import PanoramaPyramid
from core.refine.gauss_newton import Pace, StepRules, next_length
from core.refine.refinement import CandidatePoints, refine
from core.views.comparison import Comparison, compare

HEIGHT = 128


def painted(directions: torch.Tensor) -> torch.Tensor:
    x, y, z = directions.unbind(-1)
    red, green = 0.5 + 0.3 * (3 * x + 2 * y).sin(), 0.5 + 0.3 * (4 * y - z).sin()
    return torch.stack((red, green, 0.5 + 0.3 * (3 * z + x).cos()), dim=-1)


@pytest.fixture(scope="module")
def scene() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return an image (3, H, W), points (N, 3) that it shows without parallax errors, their colours, and the rotation."""
    rotation = uniform_rotations(11)[4]
    directions = torch.nn.functional.normalize(
        torch.randn((3000, 3), generator=torch.Generator().manual_seed(0)), dim=-1
    )
    distance = 1 + 3 * torch.rand((3000, 1), generator=torch.Generator().manual_seed(1))
    position = torch.tensor([0.5, -1.0, 1.2])
    points = position + distance * directions @ rotation.T
    image = painted(pixel_directions(HEIGHT, 2 * HEIGHT)).permute(2, 0, 1).contiguous()
    return image, points, painted(directions), rotation


POSITION = torch.tensor([0.5, -1.0, 1.2])


def refined_errors(
    image: torch.Tensor,
    points: torch.Tensor,
    colors: torch.Tensor,
    rotation: torch.Tensor,
    valid: torch.Tensor | None = None,
) -> tuple[float, float]:
    """Return metres and degrees off after refinement from a pose that is 0.25 m and 9 degrees off."""
    level = prepare_level(image, torch.ones(image.shape[1:]) if valid is None else valid)
    candidates = CandidatePoints(points[None], colors[None], torch.ones((1, len(points))))
    start = rotation @ rotation_from_vector(torch.tensor([0.1, -0.1, 0.07]))
    found = refine(level, candidates, start[None], (POSITION + torch.tensor([0.15, -0.15, 0.1]))[None], 25, StepRules())
    angle = float(torch.rad2deg(rotation_angle(found.rotations[0].double(), rotation.double())))
    return float((found.positions[0] - POSITION).norm()), angle


def test_refinement_converges_to_the_pose(scene: tuple[torch.Tensor, ...]) -> None:
    metres, degrees = refined_errors(*scene)
    assert metres < 0.005
    assert degrees < 0.1


def test_refinement_does_not_mind_gain_and_offset(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    metres, degrees = refined_errors(
        image * torch.tensor([0.6, 1.3, 0.9])[:, None, None] + 0.05, points, colors, rotation
    )
    assert metres < 0.005
    assert degrees < 0.1


def test_refinement_does_not_mind_that_a_third_of_the_points_changed(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    changed = colors.clone()
    changed[::3] = torch.rand((1000, 3), generator=torch.Generator().manual_seed(3))
    metres, degrees = refined_errors(image, points, changed, rotation)
    assert metres < 0.02
    assert degrees < 0.4


def test_refinement_ignores_what_is_masked(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    valid = torch.ones((HEIGHT, 2 * HEIGHT))
    valid[40:100, 30:160] = 0
    spoilt = torch.where(valid.bool(), image, torch.ones(()))
    metres, degrees = refined_errors(spoilt, points, colors, rotation, valid)
    assert metres < 0.01
    assert degrees < 0.2


def test_each_candidate_is_refined_as_if_it_were_alone(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    level = prepare_level(image, torch.ones(image.shape[1:]))
    starts = torch.stack([rotation @ rotation_from_vector(torch.tensor([a, 0.05, 0.0])) for a in (0.1, -0.1, 0.5)])
    positions = POSITION + torch.tensor([[0.1, 0, 0], [0, 0.1, 0], [0.4, 0.4, 0]])
    weights = torch.ones((3, len(points)))
    together = refine(
        level,
        CandidatePoints(points.expand(3, -1, -1), colors.expand(3, -1, -1), weights),
        starts,
        positions,
        6,
        StepRules(),
    )
    for k in range(3):
        alone = refine(
            level,
            CandidatePoints(points[None], colors[None], weights[:1]),
            starts[k : k + 1],
            positions[k : k + 1],
            6,
            StepRules(),
        )
        torch.testing.assert_close(alone.positions[0], together.positions[k], atol=2e-4, rtol=0)
        torch.testing.assert_close(alone.rotations[0], together.rotations[k], atol=2e-4, rtol=0)


def test_candidates_that_come_together_go_on_as_one_and_all_end_in_the_same_place(
    scene: tuple[torch.Tensor, ...],
) -> None:
    image, points, colors, rotation = scene
    level = prepare_level(image, torch.ones(image.shape[1:]))
    turns = (0.1, -0.1, 0.15)
    starts = torch.stack([rotation @ rotation_from_vector(torch.tensor([a, 0.05, 0.0])) for a in turns])
    # A fourth one has no points: it stays, far from the others.
    starts = torch.cat((starts, (rotation @ rotation_from_vector(torch.tensor([0.0, 0.0, 2.0])))[None]))
    weights = torch.ones((4, len(points)))
    weights[3] = 0
    candidates = CandidatePoints(points.expand(4, -1, -1), colors.expand(4, -1, -1), weights)
    rest = Rest(move_m=1e-3, turn_rad=1e-3, apart_m=0.05, apart_rad=0.03)
    found = refine(level, candidates, starts, (POSITION + 0.1).expand(4, -1), 40, StepRules(), rest)
    assert len(found.numbers) == 2
    assert int(found.numbers[1]) == 3
    torch.testing.assert_close(found.positions[0], POSITION, atol=0.005, rtol=0)
    torch.testing.assert_close(found.positions[1], POSITION + 0.1)
    assert int(found.steps[0]) < 40  # it rests when it has arrived
    assert int(found.steps[1]) == 4


def test_candidates_of_different_maps_are_never_one(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    level = prepare_level(image, torch.ones(image.shape[1:]))
    candidates = CandidatePoints(points.expand(3, -1, -1), colors.expand(3, -1, -1), torch.ones((3, len(points))))
    start = (rotation @ rotation_from_vector(torch.tensor([0.1, 0.05, 0.0]))).expand(3, -1, -1)
    rest = Rest(move_m=1e-3, turn_rad=1e-3, apart_m=0.05, apart_rad=0.03)
    maps = torch.tensor([4, 7, 4])
    found = refine(level, candidates, start, (POSITION + 0.1).expand(3, -1), 20, StepRules(), rest, maps)
    assert sorted(maps[found.numbers].tolist()) == [4, 7]


def test_a_candidate_without_a_point_stays_where_it_is(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    level = prepare_level(image, torch.ones(image.shape[1:]))
    nothing = CandidatePoints(points[None], colors[None], torch.zeros((1, len(points))))
    found = refine(level, nothing, rotation[None], POSITION[None], 3, StepRules())
    torch.testing.assert_close(found.positions[0], POSITION)
    assert bool(torch.isfinite(found.rotations).all())
    assert bool(torch.isfinite(found.loss).all())


def test_gain_and_offset_are_those_of_a_weighted_line_fit() -> None:
    rng = np.random.default_rng(0)
    source = rng.uniform(size=(200, 3))
    target = source * [0.8, 1.5, 0.6] + [0.1, -0.2, 0.05] + rng.normal(0, 0.01, (200, 3))
    weights = rng.uniform(size=200)
    gain, offset = fit_gain_offset(
        torch.from_numpy(source)[None], torch.from_numpy(target)[None], torch.from_numpy(weights)[None]
    )
    for channel in range(3):
        slope, intercept = np.polyfit(source[:, channel], target[:, channel], 1, w=np.sqrt(weights))
        assert float(gain[0, channel]) == pytest.approx(slope, abs=0.02)
        assert float(offset[0, channel]) == pytest.approx(intercept, abs=0.02)


# The judge.


@pytest.fixture(scope="module")
def comparisons(box_index: MapIndex, box_panorama: Panorama, box_pose: Pose) -> Comparison:
    """Return the comparison at the true pose, 10 cm beside it, 10 degrees beside it, and far away."""
    true_rotation = torch.from_numpy(box_pose.rotation).float()
    turned = true_rotation @ rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(10)]))
    far = true_rotation @ rotation_from_vector(torch.tensor([0.0, 0.0, 2.0]))
    position = torch.from_numpy(box_pose.position).float()
    rotations = torch.stack((true_rotation, true_rotation, turned, far))
    positions = torch.stack((position, position + torch.tensor([0.1, 0, 0]), position, torch.tensor([4.0, 1.0, 1.0])))
    level = PanoramaPyramid(box_panorama, 64, None, "cpu").level(64)
    return compare(box_index.render_cloud, level, rotations, positions, 64, False)


def test_the_judge_prefers_the_true_pose_and_falls_with_the_error(comparisons: Comparison) -> None:
    score = agreement(comparisons, 64).score
    assert int(score.argmax()) == 0
    assert float(score[0]) > float(score[1]) > float(score[3])
    assert float(score[0]) > float(score[2]) > float(score[3])


def test_measures_of_agreement_stay_in_their_ranges(comparisons: Comparison) -> None:
    measured = agreement(comparisons, 64)
    for values in (measured.correlation, measured.patch_correlation):
        assert float(values.abs().max()) <= 1 + 1e-5
    assert float(measured.mutual_information.min()) >= -1e-4
    for values in (measured.inlier_share, measured.coverage):
        assert 0 <= float(values.min()) <= float(values.max()) <= 1 + 1e-4


def test_the_judge_does_not_see_a_growing_tone_curve(
    comparisons: Comparison, box_index: MapIndex, box_panorama: Panorama, box_pose: Pose
) -> None:
    dark = Panorama((255 * (box_panorama.color / 255.0) ** 2).round().astype(np.uint8), box_panorama.valid)
    level = PanoramaPyramid(dark, 64, None, "cpu").level(64)
    rotation = torch.from_numpy(box_pose.rotation).float()[None]
    position = torch.from_numpy(box_pose.position).float()[None]
    relit = compare(box_index.render_cloud, level, rotation, position, 64, False)
    assert float(agreement(relit, 64).score[0]) == pytest.approx(float(agreement(comparisons, 64).score[0]), abs=0.06)


# Confidence.


def test_confidence_never_falls_with_a_sign_of_agreement_and_grows_with_most() -> None:
    model = load_confidence_model()
    base = dict.fromkeys(FEATURES, 0.2)
    grown = [model.probability(base | {name: 0.4}) - model.probability(base) for name in FEATURES]
    assert min(grown) >= 0
    assert sum(growth > 0 for growth in grown) >= 4
    assert 0 <= model.probability(dict.fromkeys(FEATURES, -1e6)) < 1e-6
    assert 1 - 1e-6 < model.probability(dict.fromkeys(FEATURES, 1e6)) <= 1


def test_a_sharper_loss_means_a_smaller_error_radius() -> None:
    model = ConfidenceModel(0.0, {}, 0.5, RadiusModel(0.0, 1.0, 0.0), RadiusModel(0.0, 1.0, 0.0))
    base = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), 0.0, hessian=torch.eye(6) * 100, residual_scale=0.1)
    sharp = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), 0.0, hessian=torch.eye(6) * 400, residual_scale=0.1)
    wide, narrow = (error_radii(formal_radii(one), {"patch_correlation": 0.5}, model) for one in (base, sharp))
    assert wide[0] is not None
    assert narrow[0] is not None
    assert narrow[0] == pytest.approx(wide[0] / 2, rel=1e-3)


def test_less_agreement_never_means_a_smaller_error_radius() -> None:
    model = load_confidence_model()
    alike, unlike = (error_radii((0.01, 0.1), {"patch_correlation": value}, model) for value in (0.9, 0.3))
    assert alike[0] is not None
    assert unlike[0] is not None
    assert unlike[0] >= alike[0]


def test_without_a_curvature_there_is_no_error_radius() -> None:
    hypothesis = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), 0.0)
    assert error_radii(formal_radii(hypothesis), {}, load_confidence_model()) == (None, None)


def test_hypotheses_that_converged_to_one_pose_count_once() -> None:
    near = [Hypothesis(0, k, torch.eye(3), torch.tensor([0.01 * k, 0, 0]), 0.0, score=0.5 + 0.1 * k) for k in range(4)]
    apart = Hypothesis(0, 9, torch.eye(3), torch.tensor([2.0, 0, 0]), 0.0, score=0.1)
    elsewhere = Hypothesis(1, 0, torch.eye(3), torch.zeros(3), 0.0, score=0.2)
    kept = best_distinct([*near, apart, elsewhere], 5)
    assert [h.score for h in kept] == [near[3].score, 0.2, 0.1]


# Labels.


def test_rare_colours_are_noise_not_labels() -> None:
    colors = torch.zeros((50_000, 3), dtype=torch.uint8)
    colors[25_000:] = 255
    colors[7] = torch.tensor([9, 99, 199], dtype=torch.uint8)
    assert len(label_codes(colors).labels) == 2


def test_an_unknown_label_in_a_panorama_is_masked() -> None:
    scan = torch.tensor([[255, 0, 0], [0, 0, 255]], dtype=torch.uint8).repeat(100, 1)
    color = np.zeros((64, 128, 3), np.uint8)
    color[:, :64] = [255, 0, 0]
    color[:, 64:] = [10, 200, 90]
    level = PanoramaPyramid(Panorama(color, np.ones((64, 128), bool)), 64, label_codes(scan), "cpu").level(64)
    assert bool((level.valid[:, :64] == 1).all())
    assert bool((level.valid[:, 64:] == 0).all())


def placed(x: float, score: float = 0.0, loss: float = 0.0, map_number: int = 0) -> Hypothesis:
    """Return a hypothesis `x` metres along an axis."""
    return Hypothesis(map_number, 0, torch.eye(3), torch.tensor([x, 0.0, 0.0]), 0.0, score=score, loss=loss)


def test_of_candidates_that_met_the_one_of_smallest_loss_stays() -> None:
    found = converged(
        [placed(0.0, loss=0.3), placed(0.05, loss=0.1), placed(1.0, loss=0.2), placed(0.05, map_number=1)]
    )
    assert [(h.map_number, h.loss) for h in found] == [(1, 0.0), (0, 0.1), (0, 0.2)]


def test_hopeless_candidates_go_but_the_best_one_elsewhere_stays() -> None:
    ranked = [placed(0.0, 1.4), placed(0.2, 1.3), placed(5.0, 0.6), placed(9.0, 0.5)]
    assert [h.score for h in promising(ranked, 8, 0.35)] == [1.4, 1.3, 0.6]
    close = [placed(0.0, 1.4), placed(5.0, 1.3), placed(9.0, 0.5)]
    assert [h.score for h in promising(close, 8, 0.35)] == [1.4, 1.3]
    assert promising([], 8, 0.35) == []


@pytest.mark.parametrize(
    ("slope_before", "slope_after", "length"),
    [
        (-1.0, -0.5, 3.0),  # half way: twice as long
        (-1.0, -0.9, 3.0),  # hardly begun: no more than twice at once
        (-1.0, 0.0, 1.5),  # there
        (-1.0, 0.5, 1.0),  # beyond: two thirds of it
        (-1.0, -1.2, 3.0),  # it became steeper
        (0.0, 0.0, 1.5),  # the first step
    ],
)
def test_steps_are_lengthened_by_what_the_last_one_fell_short(
    slope_before: float, slope_after: float, length: float
) -> None:
    rules = StepRules(relaxation=1.5, max_relaxation=5.0)
    step = torch.tensor([[0.0, 0.0, 0.0, 0.0, 1.0, 0.0]])
    pace = Pace(step, torch.tensor([slope_before]), torch.tensor([1.5]))
    found = next_length(pace, step * slope_after, rules)
    assert found.tolist() == pytest.approx([length])


def test_steps_grow_no_longer_than_the_rules_allow() -> None:
    rules, step = StepRules(max_relaxation=5.0), torch.eye(6)[:1]
    pace = Pace(step, torch.tensor([-1.0]), torch.tensor([4.0]))
    assert next_length(pace, -0.9 * step, rules).tolist() == [5.0]


def test_steps_that_learn_reach_the_pose_where_noise_makes_plain_ones_creep(scene: tuple[torch.Tensor, ...]) -> None:
    image, points, colors, rotation = scene
    noisy = image + 0.02 * torch.randn(image.shape, generator=torch.Generator().manual_seed(5))
    level = prepare_level(noisy, torch.ones(image.shape[1:]))
    candidates = CandidatePoints(points[None], colors[None], torch.ones((1, len(points))))
    start = POSITION + torch.tensor([0.15, -0.15, 0.1])
    errors = [
        float((refine(level, candidates, rotation[None], start[None], 6, rules).positions[0] - POSITION).norm())
        for rules in (StepRules(), StepRules(max_relaxation=1.5))
    ]
    assert errors[0] < 0.005
    assert errors[0] < 0.3 * errors[1]
