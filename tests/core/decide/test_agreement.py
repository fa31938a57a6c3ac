"""The judge at the true pose and at poses beside it."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.decide.agreement import Agreement, agreement
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.image.pyramid import PanoramaPyramid
from panoloc.core.render.comparison import compare
from tests.core.built_maps import BOX, POSE, map_of, panorama, tensors_of


def test_the_judge_prefers_the_true_pose_and_falls_with_the_error() -> None:
    # The true pose, 10 cm beside it, 10 degrees beside it, and far away.
    rotation, position = tensors_of(POSE)
    turns, moves = torch.zeros((4, 3)), torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0, 0, 0], [2.3, -1.4, -0.5]])
    turns[2:, 2] = torch.tensor([math.radians(10), 2.0])
    level = PanoramaPyramid(panorama(), 64, None, "cpu").level(64)
    poses = rotation @ rotation_from_vector(turns), position + moves
    score = agreement(compare(map_of(BOX).render_cloud, level, *poses, 64, False), JudgeConfig()).score
    assert int(score.argmax()) == 0
    assert float(score[1:3].min()) > float(score[3])


HEIGHT = 64
SOLID = pixel_solid_angles(HEIGHT, 2 * HEIGHT).expand(-1, 2 * HEIGHT)


def judged(
    scan: torch.Tensor, panorama: torch.Tensor, weights: torch.Tensor, config: JudgeConfig | None = None
) -> Agreement:
    """Measure one pair of images (H, W, 3) with weights (H, W)."""
    sides: Any = SimpleNamespace(
        scan=scan.flatten(0, 1)[None],
        panorama=panorama.flatten(0, 1)[None],
        weights=weights.flatten()[None],
        views=SimpleNamespace(window=SphereWindow.of_sphere(HEIGHT)),
    )
    return agreement(sides, config or JudgeConfig())


def texture(width: int) -> torch.Tensor:
    """Return black and white pixels (H, width, 3) at random."""
    return (torch.rand((HEIGHT, width, 3), generator=torch.Generator().manual_seed(1)) > 0.5).float()


@pytest.mark.parametrize("side", ["first", "second"])
def test_shifted_patches_see_what_the_borders_of_the_others_cut_in_two(side: str) -> None:
    config = JudgeConfig(shifted_patches=True)
    half = HEIGHT // config.patch_rows // 2
    scan = texture(2 * HEIGHT)
    # Half of the rows are the opposite of the scan: of whole patches of the one grid or of the other.
    rows = torch.arange(HEIGHT) + (half if side == "second" else 0)
    opposite = (rows // (2 * half)) % 2 == 1
    panorama = torch.where(opposite[:, None, None], 1 - scan, scan)
    plain, both = (judged(scan, panorama, SOLID, each) for each in (JudgeConfig(), config))
    # Where patches are whole, halves of them agree fully and say much; where they are mixed they say next to nothing.
    assert float(plain.explained) == pytest.approx(0.48 if side == "first" else 0.0, abs=0.03)
    assert float(both.explained) == pytest.approx(0.24, abs=0.03)
    assert float(both.coverage) == pytest.approx(float(plain.coverage))


def test_where_nothing_is_seen_nothing_agrees() -> None:
    scan = texture(2 * HEIGHT)
    found = judged(scan, scan, torch.zeros_like(SOLID))
    assert float(found.score) == 0
    assert float(found.coverage) == pytest.approx(0, abs=1e-9)


def test_where_half_has_changed_explained_contrast_prefers_half_that_agrees_to_all_that_agrees_a_little() -> None:
    image = texture(2 * HEIGHT)
    noise = torch.rand(image.shape, generator=torch.Generator().manual_seed(5))
    right = slice(HEIGHT, None)
    half, little = image.clone(), torch.lerp(image, noise, 0.55)
    half[:, right] = noise[:, right]
    by_patches = replace(JudgeConfig(), ranks_by_explained=True)
    found = [judged(image, other, SOLID, config) for config in (JudgeConfig(), by_patches) for other in (half, little)]
    assert float(found[0].score) < float(found[1].score)
    assert float(found[2].score) > float(found[3].score)
    assert float(found[2].explained) == pytest.approx(float(found[2].score) / 2, abs=1e-5)
    assert 0 < float(found[3].explained) < float(found[2].explained) < 0.6
