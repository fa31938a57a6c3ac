"""When candidates stop and which of them are merged, against one candidate and one step at a time."""

import math
from dataclasses import replace

import pytest
import torch

from panoloc.core.config import DISTANCES, RefinementConfig, StoppingRule
from panoloc.core.geometry.rotations import even_directions, rotation_angle, rotation_from_vector
from panoloc.core.refine.patches import patch_numbers
from panoloc.core.refine.refinement import Refined, joined, refine
from panoloc.core.refine.step import PointPlanes, PoseStep, pose_steps
from tests.core.found_pose import known
from tests.core.refine.painted_scene import level_of_sphere, painted, painted_sphere

HEIGHT, COUNT = 32, 600
CONFIG = RefinementConfig().coarse_step
PATCHES, ORDER = patch_numbers(even_directions(COUNT), 45.0).sort(stable=True)
DIRECTIONS = even_directions(COUNT)[ORDER]
# Turns (rad) and moves (m) off the true pose: two that meet, one that is nearly there, one far off.
TURNS = torch.tensor([[0.05, -0.02, 0.03], [-0.04, 0.05, 0.0], [0.001, 0.0, 0.0], [1.3, -0.9, 1.9]])
MOVES = torch.tensor([[0.1, 0.05, 0.0], [-0.1, 0.0, 0.08], [0.001, 0.0, -0.001], [0.5, 0.6, -0.4]])
FOCALS, BOUNDS = torch.tensor([0.02, -0.03, 0.01, 0.0]), (-0.05, 0.05)  # logarithms


LEVEL = level_of_sphere(painted_sphere(HEIGHT))


def candidates() -> tuple[PointPlanes, torch.Tensor, torch.Tensor]:
    """Return points of four candidates, each with points of its own, and the poses that they begin with."""
    parts = []
    for k in range(4):
        distance = 1 + 2 * torch.rand((COUNT, 1), generator=torch.Generator().manual_seed(k))
        weights = torch.rand((1, COUNT), generator=torch.Generator().manual_seed(k + 9)) + 0.5
        colors = painted(DIRECTIONS)[None]
        parts.append(PointPlanes.of_triples((distance * DIRECTIONS)[None], colors, weights, None, PATCHES))
    return joined(parts), rotation_from_vector(TURNS), MOVES


class Alone:
    """One candidate, step by step."""

    def __init__(self, number: int, bounds: tuple[float, float] | None) -> None:
        points, rotations, positions = candidates()
        one = slice(number, number + 1)
        self.number, self.points = number, points.take(torch.tensor([number]))
        self.rotation, self.position = rotations[one], positions[one]
        self.bounds, self.focal = bounds, None if bounds is None else FOCALS[one]
        self.num_steps = 0
        self.last: PoseStep | None = None

    def step(self, is_last: bool) -> None:
        pose = self.rotation, self.position, self.focal
        rules = replace(CONFIG, lengthening=1.0) if is_last else CONFIG
        self.last = pose_steps(LEVEL, self.points, *pose, rules, self.bounds)
        self.rotation, self.position, self.focal = self.last.rotations, self.last.positions, self.last.log_focals
        self.num_steps += 1

    @property
    def loss(self) -> float:
        return float(known(self.last).equations.loss)


def one_by_one(
    iterations: int, stop: StoppingRule, groups: list[int] | None, bounds: tuple[float, float] | None = None
) -> list[Alone]:
    """Refine all candidates as the rule says: after every `interval` steps the worse of two near ones goes, then those rest that
    hardly moved."""
    left = [Alone(number, bounds) for number in range(4)]
    resting: list[Alone] = []
    for done in range(1, iterations + 1):
        for each in left:
            each.step(is_last=done == iterations)
        if done % stop.interval or done == iterations:
            continue
        kept: list[Alone] = []
        for each in sorted([*left, *resting], key=lambda one: one.loss):
            if not any(are_near(each, other, groups) for other in kept):
                kept.append(each)
        left, resting = [each for each in left if each in kept], [each for each in resting if each in kept]
        for each in list(left):
            step = known(each.last).step[0]
            if max(float(step[:3].norm()), float(step[3:].norm())) < stop.pixels * math.pi / LEVEL.rows:
                left.remove(each)
                resting.append(each)
    return sorted([*left, *resting], key=lambda one: one.number)


def are_near(one: Alone, other: Alone, groups: list[int] | None) -> bool:
    if groups is not None and groups[one.number] != groups[other.number]:
        return False
    angle, near = float(rotation_angle(one.rotation[0], other.rotation[0])), DISTANCES.same
    return float((one.position - other.position).norm()) < near.distance_m and angle < math.radians(near.angle_deg)


def assert_same(found: Refined, expected: list[Alone]) -> None:
    assert found.numbers.tolist() == [each.number for each in expected]
    assert found.steps.tolist() == [each.num_steps for each in expected]
    for k, each in enumerate(expected):
        equations = known(each.last).equations
        torch.testing.assert_close(found.rotations[k], each.rotation[0], atol=1e-3, rtol=0)
        torch.testing.assert_close(found.positions[k], each.position[0], atol=1e-3, rtol=0)
        torch.testing.assert_close(found.loss[k], equations.loss[0], atol=1e-4, rtol=1e-2)
        torch.testing.assert_close(found.scale[k], equations.scale[0], atol=1e-4, rtol=1e-2)
        torch.testing.assert_close(found.hessian[k], equations.hessian[0, :6, :6], atol=0.5, rtol=1e-2)
        focal = 0.0 if each.focal is None else float(each.focal)
        assert float(found.log_focals[k]) == pytest.approx(focal, abs=1e-3)


STOPS = {
    "none": StoppingRule(0.0, 3),
    "nearly there": StoppingRule(0.5, 2),
    "early": StoppingRule(2.0, 2),
    "after every step": StoppingRule(0.3, 1),
    "seldom": StoppingRule(1.0, 5),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STOPS)
@pytest.mark.parametrize("groups", [None, [0, 1, 0, 1]], ids=["one map", "two maps"])
def test_candidates_stop_and_merge_as_if_each_went_alone(name: str, groups: list[int] | None) -> None:
    points, rotations, positions = candidates()
    of = None if groups is None else torch.tensor(groups)
    found = refine(LEVEL, points, rotations, positions, 8, CONFIG, STOPS[name], of)
    assert_same(found, one_by_one(8, STOPS[name], groups))


@pytest.mark.parametrize("bounds", [None, BOUNDS], ids=["poses", "focal lengths as well"])
@pytest.mark.parametrize("iterations", [1, 4, 5])
def test_without_a_rule_all_steps_are_taken(iterations: int, bounds: tuple[float, float] | None) -> None:
    points, rotations, positions = candidates()
    focals = None if bounds is None else FOCALS
    found = refine(LEVEL, points, rotations, positions, iterations, CONFIG, log_focals=focals, focal_bounds=bounds)
    assert_same(found, one_by_one(iterations, StoppingRule(0.0, 99), None, bounds))


def test_no_step_leaves_the_poses_as_they_are() -> None:
    points, rotations, positions = candidates()
    found = refine(LEVEL, points, rotations, positions, 0, CONFIG)
    assert torch.equal(found.rotations, rotations)
    assert torch.equal(found.positions, positions)
    assert found.steps.tolist() == [0] * 4
