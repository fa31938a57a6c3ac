"""Steps patch by patch: what is minimized, how far they go, light and votes of patches, focal lengths, halves refined apart, and sums
over patches."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from panoloc.core.config import CONTRAST, DescriptorConfig, RefinementConfig, StepConfig
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.image.level import Level
from panoloc.core.refine.patches import PatchSums
from panoloc.core.refine.refinement import Refined, halves_apart, refine
from panoloc.core.refine.step import PointPlanes, PoseStep, patch_equations, pose_steps
from tests.core.other_device import DEVICE, OtherDevice
from tests.core.painted_box import PaintedBox
from tests.core.refine.painted_scene import CAMERA, POSITION, ROTATION, level_of, scene

PLAIN = replace(RefinementConfig().step, lengthening=1.0)
CPU = torch.device("cpu")
LEVEL, POINTS = scene()
PATCHES = POINTS.sums.patches
RULES = replace(PLAIN, robust_scale=2.0)
NEAR = ((-0.02, -0.02, 0.015), (0.04, 0.03, -0.02))
FREE = (-1.0, 1.0)  # bounds of the logarithm of the focal length


def moved(turn: tuple[float, float, float], move: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
    return ROTATION @ rotation_from_vector(torch.tensor([turn])), POSITION + torch.tensor([move]) @ ROTATION[0].T


def step_at(
    pose: tuple[Tensor, Tensor],
    points: PointPlanes = POINTS,
    rules: StepConfig = PLAIN,
) -> PoseStep:
    return pose_steps(LEVEL, points, *pose, None, rules)


def level_as(factor: float) -> Level:
    """Return the photo as one of a camera whose focal length is the true one over a factor."""
    return level_of(PaintedBox(seed=3), replace(CAMERA, fx_px=CAMERA.fx_px / factor, fy_px=CAMERA.fy_px / factor))[0]


def off_by(found: tuple[Tensor, Tensor]) -> float:
    return float((found[1] - POSITION).norm())


def test_at_the_true_pose_nothing_is_left_to_explain() -> None:
    step = step_at((ROTATION, POSITION))
    beside = step_at(moved((0.0, 0.0, 0.0), (0.1, 0.1, 0.0)))
    assert float(step.equations.loss) < float(beside.equations.loss) / 3 < 1
    assert float(step.step.norm()) < 1e-3


@pytest.mark.parametrize("unknown", range(7))
def test_the_gradient_is_that_of_the_contrast_that_is_not_explained(unknown: int) -> None:
    pose, focal = moved(*NEAR), torch.tensor([0.03])
    found = patch_equations(LEVEL, POINTS, *pose, PLAIN, focal, with_focal=True)
    small = torch.zeros(7).index_fill(0, torch.tensor([unknown]), 0.001)

    def loss_at(change: Tensor) -> float:
        there = pose[0] @ rotation_from_vector(change[:3]), pose[1] + pose[0][0] @ change[3:6]
        return float(patch_equations(LEVEL, POINTS, *there, PLAIN, focal + change[6]).loss)

    rise = (loss_at(small) - loss_at(-small)) / 0.002
    # Derivatives of a picture are over two of its pixels, which makes them smaller where it is sharp.
    assert abs(rise) > 0.05
    assert float(found.gradient[0, unknown] / found.mass) == pytest.approx(rise, rel=0.1)


@pytest.mark.parametrize("unknowns", [6, 7])
def test_equations_are_those_in_which_each_patch_has_offsets_and_a_gain_as_further_unknowns(unknowns: int) -> None:
    pose, focal = moved(*NEAR), torch.tensor([0.02])
    found = patch_equations(LEVEL, POINTS, *pose, PLAIN, focal, with_focal=unknowns == 7)
    seen, inside = LEVEL.sample_points(POINTS.positions, None, *pose, focal)
    weights, colors = (POINTS.weights * inside)[0].double().numpy(), POINTS.colors[0].double().numpy()
    by_pose = torch.einsum("cdn,udn->ucn", seen.derivatives[0].double(), seen.directions[0, :unknowns].double()).numpy()
    hessian, gradient, loss = np.zeros((unknowns, unknowns)), np.zeros(unknowns), 0.0
    for patch in range(int(PATCHES.max()) + 1):
        members = np.flatnonzero((PATCHES.numpy() == patch) & (weights > 0))
        if not len(members):
            continue
        sides = seen.color[0].double().numpy()[:, members], colors[:, members]
        shown, scanned = (side - side.mean(1, keepdims=True) for side in sides)
        power_shown, power_scanned = ((side**2).sum(0).mean() + CONTRAST.noise for side in (shown, scanned))
        common = (shown * scanned).sum(0).mean()
        unexplained, gain = np.sqrt(1 - common**2 / (power_shown * power_scanned)), common / power_shown
        loss += len(members) * unexplained / weights.sum()
        if len(members) <= 5:
            continue  # so few have no vote
        offsets = np.repeat(np.eye(3)[..., None], len(members), 2)
        rows = np.concatenate((gain * by_pose[:, :, members], offsets, shown[None])).reshape(unknowns + 4, -1)
        left = (gain * shown - scanned).reshape(-1)
        # What the light of the patch would undo is projected out of the rows of the pose.
        light = rows[unknowns:]
        free = rows[:unknowns] - rows[:unknowns] @ np.linalg.pinv(light) @ light
        vote = 1 / (unexplained * power_scanned)
        hessian, gradient = hessian + vote * free @ free.T, gradient + vote * free @ left
    np.testing.assert_allclose(found.hessian[0].numpy(), hessian, rtol=2e-3, atol=1e-4 * np.abs(hessian).max())
    np.testing.assert_allclose(found.gradient[0].numpy(), gradient, rtol=2e-3, atol=1e-4 * np.abs(gradient).max())
    assert float(found.loss) == pytest.approx(loss, rel=1e-4)


def test_points_that_fit_less_lose_their_vote_by_the_square_of_how_much() -> None:
    rng = torch.Generator().manual_seed(2)
    residual = 0.2 * torch.rand(POINTS.weights.shape, generator=rng)
    # Before a wall of one colour nothing of what was scanned is explained.
    plain = replace(LEVEL, colors=torch.cat((torch.full_like(LEVEL.colors[:3], 0.5), LEVEL.colors[3:])))
    one = replace(
        POINTS, colors=residual[:, None].expand(-1, 3, -1).contiguous(), sums=PatchSums(torch.zeros_like(PATCHES))
    )
    found = patch_equations(plain, one, ROTATION, POSITION, RULES)
    inside = POINTS.weights[0].numpy() > 0
    left = residual[0].double().numpy()[inside]
    square = 3 * (left - left.mean()) ** 2
    of_variance = square / (square.mean() + CONTRAST.noise)
    votes = (1 + of_variance / (2.0**2 * np.median(of_variance))) ** -2 / (square.mean() + CONTRAST.noise)
    assert float(found.scale) == pytest.approx(np.sqrt((votes * square).mean()), rel=2e-3)
    assert float(found.loss) == pytest.approx(1.0)


# How far it goes.


def test_a_step_solves_the_damped_equations_and_moves_in_the_rigs_frame() -> None:
    rotation, position = pose = moved(*NEAR)
    step = step_at(pose)
    equations = patch_equations(LEVEL, POINTS, *pose, PLAIN)
    hessian, gradient = equations.hessian[0].double(), equations.gradient[0].double()
    expected = -torch.linalg.solve(hessian + torch.diag(PLAIN.damping * hessian.diagonal()), gradient)
    torch.testing.assert_close(step.step[0].double(), expected, rtol=1e-3, atol=1e-5)
    torch.testing.assert_close(step.rotations[0], rotation[0] @ rotation_from_vector(step.step[0, :3]))
    torch.testing.assert_close(step.positions[0], position[0] + rotation[0] @ step.step[0, 3:])


@pytest.mark.parametrize("unknowns", [6, 7])
@pytest.mark.parametrize(("turn", "move", "factor"), [(0.2, 0.0, 1.0), (0.0, 0.3, 1.0), (0.0, 0.0, 1.4)])
def test_a_step_that_goes_too_far_is_shortened_as_a_whole(
    turn: float, move: float, factor: float, unknowns: int
) -> None:
    pose, level = moved((turn, 0.0, turn), (0.0, move, 0.0)), level_as(factor)
    bounds = FREE if unknowns == 7 else None

    def bounded(most_m: float) -> Tensor:
        rules = replace(PLAIN, max_step_m=most_m)
        return pose_steps(level, POINTS, *pose, torch.zeros(1), rules, bounds).step[0]

    free = bounded(99.0)
    # In metres: turns and focal lengths move what is seen as far as one and a half times a move.
    length = max(1.5 * float(free[:3].norm()), float(free[3:6].norm()), 1.5 * float(free[6:].abs().sum()))
    torch.testing.assert_close(bounded(1.01 * length), free)
    torch.testing.assert_close(bounded(length / 3), free / 3)


def test_steps_are_lengthened_by_a_factor() -> None:
    pose, plain = moved(*NEAR), replace(PLAIN, max_step_m=99.0)
    step = step_at(pose, rules=replace(plain, lengthening=1.3)).step
    torch.testing.assert_close(step, 1.3 * step_at(pose, rules=plain).step)


# Light, and what changed.


def test_each_patch_may_have_a_light_of_its_own() -> None:
    rng = torch.Generator().manual_seed(5)
    count = int(PATCHES.max()) + 1
    gain, offset = 0.5 + torch.rand(count, 1, generator=rng), torch.rand(count, 3, generator=rng) - 0.5
    lit = replace(POINTS, colors=POINTS.colors * gain[PATCHES].T + offset[PATCHES].T)
    begun = moved((0.02, -0.03, 0.02), (0.1, 0.05, -0.05))
    found = refine(LEVEL, lit, *begun, 20, RULES)
    assert off_by((found.rotations, found.positions)) < 0.01


def test_what_moved_in_most_of_a_photo_drags_a_photo_of_one_light_along_but_not_patches() -> None:
    # In two patches of three everything stands elsewhere than the scan says, each by a way of its own; and each has its lamp.
    rng = torch.Generator().manual_seed(2)
    count = int(PATCHES.max()) + 1
    away = torch.randn(count, 3, generator=rng) * 0.4 * (torch.arange(count) % 3 > 0)[:, None]
    gain = 0.4 + torch.rand(count, 1, generator=rng)
    colors = POINTS.colors * gain[PATCHES].T
    changed = replace(POINTS, positions=POINTS.positions + away[PATCHES].T, colors=colors)
    begun = moved((0.01, -0.02, 0.01), (0.06, 0.04, -0.03))
    by_patches = refine(LEVEL, changed, *begun, 20, RULES)
    as_a_whole = refine(LEVEL, replace(changed, sums=PatchSums(torch.zeros_like(PATCHES))), *begun, 20, RULES)
    assert off_by((by_patches.rotations, by_patches.positions)) < 0.03
    assert off_by((as_a_whole.rotations, as_a_whole.positions)) > 0.06


def test_without_points_in_view_a_pose_stays_where_it_is() -> None:
    nothing = replace(POINTS, weights=torch.zeros_like(POINTS.weights))
    found = refine(LEVEL, nothing, ROTATION, POSITION, 4, RULES)
    torch.testing.assert_close(found.positions, POSITION)
    assert torch.isfinite(found.hessian).all()


# Focal lengths that are not known: the photo, taken for one of another camera.


def with_focal(
    factor: float,
    bounds: tuple[float, float] | None,
    points: PointPlanes = POINTS,
    iterations: int = 20,
    log_focal: float = 0.0,
) -> Refined:
    """Refine from beside the true pose and the focal length that a camera seems to have."""
    begun = moved((0.0, 0.0, 0.0), (0.15, 0.05, 0.0))
    log = torch.tensor([log_focal])
    return refine(level_as(factor), points, *begun, iterations, PLAIN, log_focals=log, focal_bounds=bounds)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.3])
def test_a_wrong_focal_length_is_mended_with_the_pose_that_it_led_to(factor: float) -> None:
    found = with_focal(factor, FREE)
    assert float(found.log_focals.exp()) == pytest.approx(factor, rel=0.01)
    assert off_by((found.rotations, found.positions)) < 0.03


def test_it_is_mended_although_most_of_the_room_has_changed_and_less_is_known_of_it_then() -> None:
    is_changed = PATCHES % 5 > 1
    changed = replace(POINTS, colors=torch.where(is_changed, scene(seed=8)[1].colors, POINTS.colors))
    found = with_focal(1.15, FREE, changed)
    assert float(found.log_focals.exp()) == pytest.approx(1.15, rel=0.03)
    assert 0 < float(found.information) < float(with_focal(1.15, FREE).information)


def test_of_a_plain_wall_nothing_is_known() -> None:
    plain = replace(POINTS, colors=torch.full_like(POINTS.colors, 0.5))
    found = with_focal(1.0, FREE, plain, 4)
    assert float(found.information) == pytest.approx(0.0, abs=1e-3)
    assert torch.isfinite(found.positions).all()


def test_the_information_is_the_curvature_of_the_loss_where_the_pose_follows() -> None:
    focal = torch.zeros(1)
    found = refine(LEVEL, POINTS, ROTATION, POSITION, 1, PLAIN, log_focals=focal, focal_bounds=FREE)
    equations = patch_equations(LEVEL, POINTS, ROTATION, POSITION, PLAIN, focal, with_focal=True)
    # The variance that is left of the last unknown where all are free.
    variance = np.linalg.inv(equations.hessian[0].double().numpy())[6, 6]
    assert float(found.information) == pytest.approx(1 / (variance * float(equations.mass)), rel=0.02)


@pytest.mark.parametrize(("bounds", "reached"), [((-0.05, 0.1), 0.1), ((-0.3, -0.05), -0.05), ((0.0, 0.0), 0.0)])
@pytest.mark.parametrize("iterations", [1, 3, 20])
def test_no_step_leads_beyond_the_bounds_of_the_focal_length(
    bounds: tuple[float, float], reached: float, iterations: int
) -> None:
    found = with_focal(1.3, bounds, iterations=iterations)
    assert bounds[0] - 1e-6 <= float(found.log_focals) <= bounds[1] + 1e-6
    if iterations == 20:  # and the pose is the one that fits best with it
        assert float(found.log_focals) == pytest.approx(reached)
        known = with_focal(1.3, None, log_focal=reached)
        torch.testing.assert_close(found.positions, known.positions, atol=0.005, rtol=0)


def test_a_focal_length_that_is_known_stays_and_is_that_of_the_pose() -> None:
    wrong, factor = level_as(1.3), torch.tensor([1.3])
    begun = moved((0.01, 0.0, 0.0), (0.1, 0.05, 0.0))
    known = refine(wrong, POINTS, *begun, 20, PLAIN, log_focals=factor.log())
    as_given = refine(wrong, POINTS, *begun, 20, PLAIN)
    torch.testing.assert_close(known.log_focals, factor.log())
    assert float(known.information) == 0.0
    assert off_by((known.rotations, known.positions)) < 0.02 < 0.1 < off_by((as_given.rotations, as_given.positions))


# Halves meet where the picture was taken, whatever has changed, and nowhere else.

COLORS_ELSEWHERE = scene(seed=8)[1].colors


def apart(points: PointPlanes, level: Level = LEVEL, log_focals: Tensor | None = None) -> tuple[float, float]:
    """Return metres and degrees."""
    rules = RefinementConfig()
    some, square_deg = points.thinned(rules.halves_every), DescriptorConfig().patch_deg
    found = halves_apart(level, some, ROTATION[0], POSITION[0], log_focals, square_deg, rules)
    return float(found[0]), float(torch.rad2deg(found[1]))


def test_every_third_point_keeps_its_image_and_patches_are_numbered_again() -> None:
    images = torch.arange(len(PATCHES))[None]
    some = replace(POINTS, images=images).thinned(3)
    assert some.images is not None
    assert torch.equal(some.images, images[:, ::3])
    assert torch.equal(some.positions, POINTS.positions[..., ::3])
    assert torch.equal(torch.unique(some.sums.patches), torch.arange(len(torch.unique(PATCHES[::3]))))


def test_they_meet_at_the_true_pose() -> None:
    distance, angle = apart(POINTS)
    assert distance < 0.003
    assert angle < 0.1


def test_they_meet_there_with_the_focal_length_of_the_pose_and_with_no_other() -> None:
    assert apart(POINTS, level_as(1.3), torch.tensor([1.3]).log())[0] < 0.01
    assert apart(POINTS, level_as(1.3), None)[0] > 0.02


def test_they_part_where_another_place_was_scanned() -> None:
    distance, angle = apart(replace(POINTS, colors=COLORS_ELSEWHERE))
    assert distance > 0.05 or angle > 2.0


def test_they_meet_although_a_third_has_changed() -> None:
    is_changed = PATCHES % 3 == 0
    distance, angle = apart(replace(POINTS, colors=torch.where(is_changed, COLORS_ELSEWHERE, POINTS.colors)))
    assert distance < 0.03
    assert angle < 1.0


def test_halves_in_which_nothing_is_left_do_not_meet() -> None:
    distance, angle = apart(replace(POINTS, weights=torch.zeros_like(POINTS.weights)))
    assert distance >= 1.0
    assert angle >= 90.0


# Sums over patches, beside a product with who is where.


@settings(deadline=None)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=30), st.integers(0, 2**16))
def test_they_are_the_product_with_who_is_where(sizes: list[int], seed: int) -> None:
    patches = torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
    values = torch.randn((2, 3, len(patches)), generator=torch.Generator().manual_seed(seed))
    sums = PatchSums(patches)
    expected = values.double() @ torch.nn.functional.one_hot(patches).double()
    torch.testing.assert_close(sums(values).double(), expected, rtol=1e-4, atol=1e-4)
    # Also of planes that do not lie one after the other in memory.
    torch.testing.assert_close(sums(values.transpose(0, 1)), sums(values).transpose(0, 1))
    assert torch.equal(sums.spread(torch.arange(len(sizes))), patches)


@pytest.mark.slow
def test_another_device_adds_them_up_itself() -> None:
    patches, values = torch.tensor([0, 0, 1, 2, 2, 2]), torch.arange(12.0).view(2, 6)
    with torch.no_grad(), OtherDevice():
        there = PatchSums(patches.to(DEVICE))(values.to(DEVICE))
        assert there.device == DEVICE
        torch.testing.assert_close(there.cpu(), torch.tensor([[1.0, 2.0, 12.0], [13.0, 8.0, 30.0]]))


def test_points_that_do_not_follow_each_other_are_refused() -> None:
    with pytest.raises(AssertionError, match="follow each other"):
        PatchSums(torch.tensor([0, 1, 0]))
