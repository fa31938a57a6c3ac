"""The map index: what registration keeps, how it travels as bytes, and when it counts as another one."""

import dataclasses

import numpy as np
import pytest
import torch

from panoloc.core.config import CONTRAST, DescriptorConfig, IndexConfig
from panoloc.core.errors import OptionsError
from panoloc.core.index.map_builder import build_map_index, index_config_digest
from panoloc.core.index.map_codec import decode_map_index, encode_map_index
from panoloc.core.index.map_diagnostics import map_diagnostics
from panoloc.core.index.map_index import MapIndex
from panoloc.core.options import IndexOptions
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.painted_box import PaintedBox


class WithdrawnError(Exception):
    """What a caller may raise who no longer wants the work."""


@pytest.mark.slow
def test_an_index_describes_its_scan(box: PaintedBox, box_index: MapIndex) -> None:
    assert box_index.num_points == 24_000
    assert box_index.num_points_read == 24_000
    assert box_index.num_starts == len(box_index.start_positions) == len(box_index.start_leaf_sizes)
    np.testing.assert_allclose(box_index.bounds[0], [0, 0, 0], atol=0.02)
    np.testing.assert_allclose(box_index.bounds[1], box.size_m, atol=0.02)
    assert 0.02 < box_index.spacing < 0.1
    assert box_index.color_kind == "rgb"
    assert (box_index.start_leaf_sizes > 0).all()


def test_a_scanned_box_is_fit_for_use(box_index: MapIndex) -> None:
    assert map_diagnostics(box_index, IndexOptions(), box_index.num_points) == ()


def test_an_index_keeps_every_point_with_its_own_colour(box: PaintedBox, box_index: MapIndex) -> None:
    cloud = box.scan()
    rows = np.concatenate((cloud.positions, cloud.colors), axis=1)
    kept = np.concatenate((box_index.positions.numpy(), box_index.colors.numpy()), axis=1)
    np.testing.assert_array_equal(kept[np.lexsort(kept.T)], rows[np.lexsort(rows.T)])


@pytest.mark.slow
def test_registration_stops_when_its_progress_says_so(box: PaintedBox) -> None:
    def cancel(stage: str, share: float) -> None:
        if stage == "rendering starts":
            raise WithdrawnError("withdrawn")

    with pytest.raises(WithdrawnError):
        build_map_index(box.scan(3000), progress=cancel)


@pytest.mark.slow
def test_a_region_of_starts_is_given_in_the_scans_own_frame(box: PaintedBox) -> None:
    offset = np.array([1000.0, 2000.0, 30.0])
    low, high = offset + np.array([1, 1, 0.8]), offset + np.array([3, 2.5, 1.9])
    options = IndexOptions(region=(tuple(low.tolist()), tuple(high.tolist())))
    index = build_map_index(box.scan(6000, origin_offset=offset), options)
    assert (index.start_positions >= low - 1e-4).all()
    assert (index.start_positions <= high + 1e-4).all()
    with pytest.raises(OptionsError, match="region"):
        build_map_index(box.scan(6000), options)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "height_m"), [(1, 2.0), (2, 2.0), (63, 2.0), (200, 2.0), (3000, 0.0)])
def test_a_handful_of_points_or_a_flat_scan_becomes_a_map_or_is_refused_with_reason(
    count: int, height_m: float
) -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, (2, 2, height_m), (count, 3)).astype(np.float32)
    cloud = PointCloud(positions, rng.integers(0, 256, (count, 3)).astype(np.uint8))
    try:
        index = build_map_index(cloud)
    except OptionsError:
        return
    assert index.num_starts >= 1
    assert decode_map_index(encode_map_index(index)).num_points == index.num_points


# Bytes.


@pytest.fixture(scope="module")
def read_back(box_index: MapIndex) -> MapIndex:
    return decode_map_index(encode_map_index(box_index))


def test_an_index_read_back_differs_only_by_stated_rounding(box_index: MapIndex, read_back: MapIndex) -> None:
    assert float((read_back.positions - box_index.positions).abs().max()) <= box_index.spacing / 32 + 1e-6
    for name in ("starts", "leaf_sizes", "sampled_shares"):
        assert torch.equal(getattr(read_back, name), getattr(box_index, name)), name
    assert int((read_back.colors.int() - box_index.colors.int()).abs().max()) <= 255 / 63 / 2 + 1
    assert torch.equal(read_back.descriptors.basis, box_index.descriptors.basis)
    largest = box_index.descriptors.values.abs().amax((1, 2), keepdim=True)
    assert bool(((read_back.descriptors.values - box_index.descriptors.values).abs() <= largest / 62 + 1e-6).all())
    np.testing.assert_array_equal(read_back.origin_offset, box_index.origin_offset)
    assert read_back.spacing == box_index.spacing
    assert read_back.num_points_read == box_index.num_points_read


@pytest.mark.slow
def test_rounding_happens_once(box_index: MapIndex, read_back: MapIndex) -> None:
    again = decode_map_index(encode_map_index(read_back))
    torch.testing.assert_close(again.positions, read_back.positions, atol=1e-5, rtol=0)
    assert torch.equal(again.colors, read_back.colors)
    torch.testing.assert_close(again.descriptors.values, read_back.descriptors.values, atol=1e-5, rtol=1e-4)


def test_label_codes_survive() -> None:
    palette = ((0, 0, 0), (255, 0, 0), (0, 128, 255))
    index = build_map_index(
        PaintedBox(seed=1, palette=palette).scan(3000), IndexOptions(color_kind="labels", spacing_m=1.5)
    )
    back = decode_map_index(encode_map_index(index))
    assert index.labels is not None
    assert back.labels is not None
    assert torch.equal(back.labels.labels, index.labels.labels.int())
    assert torch.equal(back.labels.codes, index.labels.codes)
    assert torch.equal(back.colors, index.colors)


def test_an_index_of_a_room_takes_less_than_five_megabytes(box_index: MapIndex) -> None:
    assert len(encode_map_index(box_index)) < 5_000_000


# Digests.


def test_the_digest_changes_with_every_option_and_every_setting() -> None:
    options = [
        IndexOptions(),
        IndexOptions(starts_method="grid"),
        IndexOptions(spacing_m=0.4),
        IndexOptions(color_kind="labels"),
        IndexOptions(region=((0, 0, 0), (1, 1, 1))),
    ]
    digests = [index_config_digest(option) for option in options]
    digests.append(index_config_digest(IndexOptions(), IndexConfig(descriptors=DescriptorConfig(bins=6))))
    digests.append(index_config_digest(IndexOptions(), IndexConfig(finest_spacing_m=0.05)))
    assert len(set(digests)) == len(digests)
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in digests)
    assert index_config_digest(IndexOptions()) == digests[0]


def test_every_setting_of_the_index_is_in_the_digest() -> None:
    base = IndexConfig()
    for section in dataclasses.fields(base):
        value = getattr(base, section.name)
        for field in dataclasses.fields(value) if dataclasses.is_dataclass(value) else ():
            inner = getattr(value, field.name)
            changed = dataclasses.replace(value, **{field.name: inner + type(inner)(1)})
            assert dataclasses.replace(base, **{section.name: changed}).digest() != base.digest(), field.name


def test_what_all_images_are_made_with_is_in_the_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    before = IndexConfig().digest()
    monkeypatch.setattr("panoloc.core.config.index.CONTRAST", dataclasses.replace(CONTRAST, rows=8))
    assert IndexConfig().digest() != before
