"""The judge at the true pose and at poses beside it."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_solid_angles
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.index.map_index import MapIndex
from panoloc.core.judge.agreement import Agreement, agreement
from panoloc.core.panorama.panorama import Panorama
from panoloc.core.panorama.pyramid import PanoramaPyramid
from panoloc.core.views.comparison import Comparison, compare


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
    score = agreement(comparisons, JudgeConfig()).score
    assert int(score.argmax()) == 0
    assert float(score[0]) > float(score[1]) > float(score[3])
    assert float(score[0]) > float(score[2]) > float(score[3])


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


def test_the_same_agreement_on_a_quarter_of_the_sphere_counts_half() -> None:
    image = texture(HEIGHT // 2).repeat(1, 4, 1)  # every quarter is alike
    quarter = SOLID.clone()
    quarter[:, HEIGHT // 2 :] = 0
    whole, part = judged(image, image, SOLID), judged(image, image, quarter)
    assert float(whole.coverage) == pytest.approx(1, abs=1e-4)
    assert float(part.coverage) == pytest.approx(0.25, abs=1e-4)
    assert float(part.correlation) == pytest.approx(float(whole.correlation), abs=1e-4)
    assert float(part.score) == pytest.approx(float(whole.score) / 2, abs=1e-3)


def test_a_patch_counts_by_what_is_seen_of_it() -> None:
    scan = texture(2 * HEIGHT)
    panorama, weights = scan.clone(), SOLID.clone()
    right = slice(HEIGHT, None)
    panorama[:, right] = 1 - panorama[:, right]  # the opposite of the scan
    assert float(judged(scan, panorama, weights).patch_correlation) == pytest.approx(0, abs=0.01)
    weights[:, right] /= 3
    assert float(judged(scan, panorama, weights).patch_correlation) == pytest.approx(0.5, abs=0.01)


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
