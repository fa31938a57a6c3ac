"""The method of the paper in a tiny cloud."""

import math
import time
from functools import cache
from typing import Any

import pytest
import torch

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig, PaperConfig
from panoloc.core.errors import DeadlineExceededError
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.results import Localization
from tests.core.built_maps import BOX, COARSE, POSE
from tests.core.found_pose import assert_found, best_of

pytestmark = pytest.mark.slow
SMALL = {"num_starts": 12, "num_rotations": 24, "iterations": 5, "view_height": 64, "num_candidates": 2}


@cache
def tiny_index() -> MapIndex:
    return build_map_index(BOX.scan(4000), COARSE)


def answer_with(timeout_s: float | None = None, **config: Any) -> Localization:
    localizer = Localizer(LocalizerConfig(paper=PaperConfig(**config)), device="cpu")
    rig = Rig.of_panorama(BOX.panorama(POSE, 128))
    return localizer.localize(rig, [tiny_index()], method="paper", timeout_s=timeout_s, top_k=6)


def test_the_paper_method_lands_near() -> None:
    sizes = {"num_starts": 30, "num_rotations": 216, "iterations": 40, "view_height": 64}
    found = answer_with(**sizes, map_rows=8, map_columns=16)
    assert torch.is_grad_enabled()
    assert_found(found, POSE, 0.3, 10.0)
    assert (found.search.method, best_of(found).color_model) == ("paper", "global_transport")


def test_the_paper_method_ranks_by_the_sampling_loss() -> None:
    found = answer_with(**(SMALL | {"iterations": 1, "num_candidates": 6}))  # hardly refined they stay apart
    losses = [candidate.sampling_loss for candidate in (best_of(found), *found.alternatives)]
    assert losses == sorted(losses)
    assert len(set(losses)) > 1


@pytest.mark.parametrize(
    "ablation",
    [
        {"match_colors": False},
        {"initialize_by_histograms": False, "num_starts": 4},
        {"use_score_map_2d": False},
        {"use_score_map_3d": False},
    ],
)
def test_the_paper_method_runs_without_each_of_its_parts(ablation: dict[str, Any]) -> None:
    found = answer_with(**(SMALL | ablation))
    assert math.isfinite(best_of(found).sampling_loss)
    assert found.search.num_poses > 0


def test_the_paper_method_stops_soon_after_its_deadline() -> None:
    tiny_index()
    began = time.process_time()
    with pytest.raises(DeadlineExceededError):
        answer_with(0.5, **(SMALL | {"num_starts": 4, "iterations": 1_000_000}))
    assert time.process_time() - began < 2.0
