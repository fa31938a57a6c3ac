"""Everything computes where the localizer was told to, without a GPU to try it on."""

import contextlib

import pytest
import torch

from panoloc.core.geometry.pose import pose_error
from panoloc.core.index.map_builder import build_map_index
from panoloc.core.index.map_index import MapIndex
from panoloc.core.localizer import Localizer
from panoloc.core.options import IndexOptions
from panoloc.core.panorama.panorama import Panorama
from tests.core.other_device import DEVICE, FarTensor, OtherDevice
from tests.core.painted_box import PaintedBox

# Each costs a GPU some 20 microseconds of waiting; a query on a map of one box asks for fewer.
MOST_ASKED = 220


@pytest.fixture(autouse=True)
def _no_inference_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tensors that wrap others cannot be made in inference mode."""

    def without_gradients(enabled: bool = True) -> contextlib.AbstractContextManager[object]:
        return torch.no_grad() if enabled else contextlib.nullcontext()

    monkeypatch.setattr(torch, "inference_mode", without_gradients)


@pytest.mark.slow
def test_a_query_computes_where_its_localizer_is(
    localizer: Localizer, box_index: MapIndex, box_panorama: Panorama
) -> None:
    here = localizer.localize(box_panorama, [box_index])
    with OtherDevice() as device:
        there = Localizer(device=str(DEVICE)).localize(box_panorama, [box_index.to(DEVICE)])
        assert there.score_points is not None
        assert len(there.score_points()) == box_index.num_points
    assert here.best is not None
    assert there.best is not None
    error = pose_error(there.best.pose, here.best.pose)
    assert error.position_m < 1e-3
    assert error.orientation_deg < 0.05
    assert there.best.confidence == pytest.approx(here.best.confidence, abs=0.01)
    print(f"operations started {sum(device.started.values())}, values asked for {dict(device.asked)}")
    assert sum(device.asked.values()) < MOST_ASKED


@pytest.mark.slow
def test_an_index_is_built_where_it_is_told(box: PaintedBox) -> None:
    cloud, options = box.scan(5000), IndexOptions(starts_method="grid", spacing_m=1.5)
    here = build_map_index(cloud, options)
    with OtherDevice():
        there = build_map_index(cloud, options, device=DEVICE)
        assert isinstance(there.descriptors.values, FarTensor)
        values = there.descriptors.values.cpu()
    torch.testing.assert_close(values.abs(), here.descriptors.values.abs(), atol=1e-3, rtol=0)
