"""The judge at the true pose and at poses beside it."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.agreement import Agreement, agreement
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.render.comparison import RigView
from tests.core.built_maps import BOX, POSE, map_of, panorama, rig_of, tensors_of

JUDGE = JudgeConfig()
PATCH_DEG = 22.5


def test_the_judge_prefers_the_true_pose_and_falls_with_the_error() -> None:
    # The true pose, 10 cm beside it, 10 degrees beside it, and far away.
    rotation, position = tensors_of(POSE)
    turns, moves = torch.zeros((4, 3)), torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 0], [2.3, -1.4, -0.5]])
    turns[2:, 2] = torch.tensor([math.radians(10), 2.0])
    view = RigView(RigPyramid(rig_of(panorama()), 64, None, "cpu"), 8.0)
    poses = rotation @ rotation_from_vector(turns), position + moves
    score = agreement(view.compare(map_of(BOX).render_cloud, *poses, 64), JUDGE, 1.0, PATCH_DEG).score
    assert int(score.argmax()) == 0
    assert float(score[1:3].min()) > float(score[3])


HEIGHT = 64
SOLID = pixel_solid_angles(HEIGHT, 2 * HEIGHT).expand(-1, 2 * HEIGHT)


def judged(
    scan: torch.Tensor,
    seen: torch.Tensor,
    weights: torch.Tensor = SOLID,
    share: float = 1.0,
    lines: torch.Tensor | None = None,
) -> Agreement:
    """Measure one pair of images (H, W, 3) with weights (H, W)."""
    sides: Any = SimpleNamespace(
        scan=scan.flatten(0, 1)[None],
        seen=seen.flatten(0, 1)[None],
        weights=weights.flatten()[None],
        views=SimpleNamespace(window=SphereWindow.of_sphere(HEIGHT)),
    )
    return agreement(sides, JUDGE, share, PATCH_DEG, lines)


def texture(width: int = 2 * HEIGHT) -> torch.Tensor:
    """Return black and white pixels (H, width, 3) at random."""
    return (torch.rand((HEIGHT, width, 3), generator=torch.Generator().manual_seed(1)) > 0.5).float()


@pytest.mark.parametrize("grid", ["first", "second"])
def test_patches_see_what_the_borders_of_the_others_cut_in_two(grid: str) -> None:
    side = round(HEIGHT * PATCH_DEG / 180)
    scan = texture()
    # Half of the rows are the opposite of the scan: of whole patches of the one grid or of the other.
    rows = torch.arange(HEIGHT) + (side // 2 if grid == "second" else 0)
    opposite = (rows // side) % 2 == 1
    found = judged(scan, torch.where(opposite[:, None, None], 1 - scan, scan))
    # Where patches are whole, half of them agree fully; where they are mixed they say next to nothing. Both count alike.
    assert float(found.explained) == pytest.approx(0.24, abs=0.03)
    assert float(found.coverage) == pytest.approx(1.0)


def test_where_nothing_is_seen_nothing_agrees() -> None:
    found = judged(texture(), texture(), torch.zeros_like(SOLID))
    assert float(found.score) == 0
    assert float(found.coverage) == pytest.approx(0, abs=1e-9)


def test_where_half_has_changed_half_that_agrees_is_preferred_to_all_that_agrees_a_little() -> None:
    image = texture()
    noise = torch.rand(image.shape, generator=torch.Generator().manual_seed(5))
    half, little = image.clone(), torch.lerp(image, noise, 0.55)
    half[:, HEIGHT:] = noise[:, HEIGHT:]
    by_half, by_little = judged(image, half), judged(image, little)
    assert float(by_half.correlation) < float(by_little.correlation)
    assert float(by_half.score) > float(by_little.score)
    assert 0 < float(by_little.explained) < float(by_half.explained) < 0.6


def test_what_is_missing_of_a_photo_costs_less_than_what_disagrees_and_what_lines_deny_costs_a_share() -> None:
    image, quarter = texture(), SOLID.clone()
    quarter[:, HEIGHT // 2 :] = 0
    whole, part = judged(image, image, quarter, share=0.25), judged(image, image, quarter, share=1.0)
    assert float(whole.relative_coverage) == pytest.approx(1.0, abs=1e-5)
    assert float(part.relative_coverage) == pytest.approx(0.25, abs=1e-5)
    assert float(part.score) == pytest.approx(float(whole.score) / 2, rel=1e-4)
    against = judged(image, image, quarter, share=0.25, lines=torch.tensor([0.0]))
    assert float(against.score) == pytest.approx((1 - JUDGE.lines_share) * float(whole.score), rel=1e-5)
