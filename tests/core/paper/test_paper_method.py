"""The method of the paper in a tiny cloud."""

import math
import time
from collections.abc import Iterator

import pytest
import torch

from panoloc.core.config import LocalizerConfig, PaperConfig
from panoloc.core.errors import DeadlineExceededError
from panoloc.core.geometry.pose import Pose
from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.options import IndexOptions
from panoloc.core.results import Localization
from tests.core.found_pose import assert_found
from tests.core.painted_box import PaintedBox


@pytest.fixture(scope="module")
def small_paper() -> Localizer:
    config = LocalizerConfig(
        paper=PaperConfig(num_starts=30, num_rotations=216, iterations=40, view_height=64, map_rows=8, map_columns=16)
    )
    return Localizer(config, device="cpu")


@pytest.fixture(scope="module")
def tiny_index(box: PaintedBox) -> MapIndex:
    return build_map_index(box.scan(4000), IndexOptions(spacing_m=0.8))


@pytest.fixture(scope="module")
def paper_answer(
    small_paper: Localizer, tiny_index: MapIndex, box: PaintedBox, box_pose: Pose
) -> Iterator[Localization]:
    panorama = box.panorama(box_pose, 128)
    yield small_paper.localize(panorama, [tiny_index], method="paper")
    assert torch.is_grad_enabled()


@pytest.mark.slow
def test_the_paper_method_lands_near_in_a_tiny_cloud(paper_answer: Localization, box_pose: Pose) -> None:
    assert_found(paper_answer, box_pose, 0.3, 10.0)
    assert paper_answer.search.method == "paper"


@pytest.mark.slow
def test_the_paper_method_ranks_by_the_sampling_loss(paper_answer: Localization) -> None:
    assert paper_answer.best is not None
    losses = [candidate.sampling_loss for candidate in (paper_answer.best, *paper_answer.alternatives)]
    assert losses == sorted(losses)
    assert paper_answer.best.color_model == "global_transport"


@pytest.mark.slow
@pytest.mark.parametrize(
    "ablation",
    [
        {"match_colors": False},
        {"initialize_by_histograms": False, "num_starts": 4, "num_rotations": 24},
        {"use_score_map_2d": False},
        {"use_score_map_3d": False},
    ],
)
def test_the_paper_method_runs_without_each_of_its_parts(
    tiny_index: MapIndex, box: PaintedBox, box_pose: Pose, ablation: dict[str, object]
) -> None:
    sizes = {"num_starts": 12, "num_rotations": 24, "iterations": 5, "view_height": 64, "num_candidates": 2}
    config = LocalizerConfig(paper=PaperConfig(**(sizes | ablation)))  # type: ignore[arg-type]
    found = Localizer(config, device="cpu").localize(box.panorama(box_pose, 128), [tiny_index], method="paper")
    assert found.best is not None
    assert math.isfinite(found.best.sampling_loss)
    assert found.search.num_poses > 0


@pytest.mark.slow
def test_the_paper_method_stops_soon_after_its_deadline(box: PaintedBox, box_pose: Pose, tiny_index: MapIndex) -> None:
    config = PaperConfig(
        num_starts=4, num_rotations=24, iterations=1_000_000, view_height=64, map_rows=8, map_columns=16
    )
    endless = Localizer(LocalizerConfig(paper=config), device="cpu")
    began = time.process_time()
    with pytest.raises(DeadlineExceededError):
        endless.localize(box.panorama(box_pose, 128), [tiny_index], method="paper", timeout_s=0.5)
    assert time.process_time() - began < 2.0
