"""Everything computes where the localizer was told to, without a GPU to try it on."""

import contextlib

import pytest
import torch

from panoloc.core.geometry.pose import pose_error
from panoloc.core.localizer import Localizer
from panoloc.core.map.map_builder import build_map_index
from panoloc.core.options import IndexOptions
from tests.core.built_maps import BOX, answer, map_of, panorama
from tests.core.found_pose import best_of, known
from tests.core.other_device import DEVICE, FarTensor, OtherDevice

pytestmark = pytest.mark.slow
# Each costs a GPU some 20 microseconds of waiting; a query on a map of one box asks for fewer.
MOST_ASKED = 220


@pytest.fixture(autouse=True)
def _no_inference_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors that wrap others cannot be made in inference mode."""

    def without_gradients(enabled: bool = True) -> contextlib.AbstractContextManager[object]:
        return torch.no_grad() if enabled else contextlib.nullcontext()

    monkeypatch.setattr(torch, "inference_mode", without_gradients)


def test_a_query_computes_where_its_localizer_is() -> None:
    here = best_of(answer())
    with OtherDevice() as device:
        found = Localizer(device=str(DEVICE)).localize(panorama(), [map_of(BOX).to(DEVICE)])
        assert len(known(found.score_points)()) == map_of(BOX).num_points
    there = best_of(found)
    assert pose_error(there.pose, here.pose).within(1e-3, 0.05)
    assert there.confidence == pytest.approx(here.confidence, abs=0.01)
    print(f"operations started {sum(device.started.values())}, values asked for {dict(device.asked)}")
    assert sum(device.asked.values()) < MOST_ASKED


def test_an_index_is_built_where_it_is_told() -> None:
    cloud, options = BOX.scan(5000), IndexOptions(starts_method="grid", spacing_m=1.5)
    here = build_map_index(cloud, options)
    with OtherDevice():
        there = build_map_index(cloud, options, device=DEVICE)
        assert isinstance(there.descriptors.values, FarTensor)
        values = there.descriptors.values.cpu()
    torch.testing.assert_close(values.abs(), here.descriptors.values.abs(), atol=1e-3, rtol=0)
