"""Everything computes where the localizer was told to, without a GPU to try it on."""

import contextlib
from dataclasses import replace

import pytest
import torch

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.geometry.pose import pose_error
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.map.retrieval_vectors import RetrievalVectors, retrieval_vectors
from panoloc.core.options import IndexOptions
from panoloc.core.query.map_query import PreparedRig
from panoloc.core.results import Candidate
from panoloc.core.search.retrieval import scores_of_maps
from tests.core.built_maps import BOX, COARSE, OTHER_BOX, localized, map_of, panorama, rig_of
from tests.core.found_pose import best_of, known
from tests.core.image.painted_photos import session_of
from tests.core.other_device import DEVICE, FarTensor, OtherDevice

# Each operation comes to Python, which takes twice as long where every line is watched; other tests run the same lines.
pytestmark = pytest.mark.slow
# Each costs a GPU some 20 microseconds of waiting; a query on a map of one box asks for fewer.
MOST_ASKED = 356


@pytest.fixture(autouse=True)
def _no_inference_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors that wrap others cannot be made in inference mode."""

    def without_gradients(enabled: bool = True) -> contextlib.AbstractContextManager[object]:
        return torch.no_grad() if enabled else contextlib.nullcontext()

    monkeypatch.setattr(torch, "inference_mode", without_gradients)


def test_a_query_computes_where_its_localizer_is() -> None:
    here = best_of(localized(panorama()))
    with OtherDevice() as device:
        found = Localizer(device=str(DEVICE)).localize(rig_of(panorama()), [map_of(BOX, COARSE).to(DEVICE)])
        assert len(known(found.score_points)()) == map_of(BOX, COARSE).num_points
    assert_same(best_of(found), here)
    print(f"operations started {sum(device.started.values())}, values asked for {dict(device.asked)}")
    assert sum(device.asked.values()) < MOST_ASKED


def test_retrieval_compares_there() -> None:
    boxes, rig = (OTHER_BOX, BOX), rig_of(panorama())
    here = [retrieval_vectors(map_of(box, COARSE)) for box in boxes]
    expected = scores_of(rig, here, "cpu")
    with OtherDevice():
        there = [retrieval_vectors(map_of(box, COARSE).to(DEVICE)) for box in boxes]
        found = scores_of(rig, there, str(DEVICE))
    assert found == pytest.approx(expected, rel=0.01)


def scores_of(rig: Rig, maps: list[RetrievalVectors], device: str) -> list[float]:
    """Return the scores of maps for a rig, worked out on a device."""
    config = LocalizerConfig()
    prepared = PreparedRig(rig, None, torch.device(device), config)
    walls = prepared.lines.best_axes(config.search.line_rotations, 0.0)
    scores = scores_of_maps(prepared.described, walls, maps, None, prepared.is_wide, config.search)
    return [float(score) for score in scores]


def test_photos_with_parallax_and_lines_are_localized_there_as_well() -> None:
    rig, config = session_of(), LocalizerConfig()
    config = replace(config, search=replace(config.search, num_candidates=8))  # each of them starts the same operations
    here = Localizer(config, device="cpu").localize(rig, [map_of(BOX, COARSE)])
    with OtherDevice():
        found = Localizer(config, device=str(DEVICE)).localize(rig, [map_of(BOX, COARSE).to(DEVICE)])
    assert_same(best_of(found), best_of(here), 0.006, 0.15)


# A micrometre at the start of the last refinement moves its end by some millimetres, where a point falls into another pixel.
def assert_same(there: Candidate, here: Candidate, position_m: float = 0.001, angle_deg: float = 0.05) -> None:
    assert pose_error(there.pose, here.pose).within(position_m, angle_deg)
    assert there.confidence == pytest.approx(here.confidence, abs=0.01)


def test_an_index_is_built_where_it_is_told() -> None:
    cloud, options = BOX.scan(5000), IndexOptions(starts_method="grid", spacing_m=2.0)
    here = build_map_index(cloud, options)
    with OtherDevice():
        there = build_map_index(cloud, options, device=DEVICE)
        assert isinstance(there.views.steps, FarTensor)
        assert isinstance(there.aliases.starts, FarTensor)
        steps, starts = there.views.steps.cpu(), there.aliases.starts.cpu()
    # Directions of the basis are the same up to their sign, and numbers up to their rounding.
    assert int((steps.int().abs() - here.views.steps.int().abs()).abs().max()) <= 1
    assert torch.equal(starts, here.aliases.starts)
