"""The map index: what registration keeps, how it travels as bytes, and when it counts as another one."""

import dataclasses

import numpy as np
import pytest
import torch

from core.config import CONTRAST, DescriptorConfig, FineViewConfig, IndexConfig, SearchConfig, StartsConfig
from core.errors import IndexFormatError, OptionsError
from core.index.map_builder import build_map_index, index_config_digest
from core.index.map_codec import decode_map_index, encode_map_index
from core.index.map_index import INDEX_VERSION, MapIndex
from core.options import IndexOptions
from core.scan.point_cloud import PointCloud
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


def test_an_index_keeps_every_point_with_its_own_colour(box: PaintedBox, box_index: MapIndex) -> None:
    cloud = box.scan()
    rows = np.concatenate((cloud.positions, cloud.colors), axis=1)
    kept = np.concatenate((box_index.positions.numpy(), box_index.colors.numpy()), axis=1)
    np.testing.assert_array_equal(kept[np.lexsort(kept.T)], rows[np.lexsort(rows.T)])


def test_the_bytes_of_an_index_are_counted(box_index: MapIndex) -> None:
    counted = box_index.num_bytes
    assert counted > box_index.num_points * 15
    assert counted < 60_000_000


@pytest.mark.slow
def test_the_sampled_share_of_a_start_is_that_of_the_sphere_where_points_lie(box: PaintedBox) -> None:
    cloud, options = box.scan(20_000), IndexOptions(starts_method="grid", spacing_m=1.2)
    below = cloud.positions[:, 2] < np.median(cloud.positions[:, 2])
    whole = build_map_index(cloud, options)
    half = build_map_index(PointCloud(cloud.positions[below], cloud.colors[below]), options)
    assert float(whole.sampled_shares.min()) > 0.5
    assert 0.3 < float(half.sampled_shares.mean() / whole.sampled_shares.mean()) < 0.7


@pytest.mark.slow
def test_progress_moves_from_stage_to_stage_and_never_back(box: PaintedBox) -> None:
    seen: list[tuple[str, float]] = []
    build_map_index(
        box.scan(3000), IndexOptions(spacing_m=1.0), progress=lambda stage, share: seen.append((stage, share))
    )
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["finding starts", "rendering starts", "describing views"]
    for stage in stages:
        shares = [share for name, share in seen if name == stage]
        assert shares == sorted(shares)
        assert 0 <= shares[0] <= shares[-1] <= 1


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
@pytest.mark.parametrize("count", [1, 2, 63, 200])
def test_a_scan_of_a_handful_of_points_becomes_a_map_or_is_refused_with_reason(count: int) -> None:
    rng = np.random.default_rng(0)
    positions = rng.uniform(0, 2, (count, 3)).astype(np.float32)
    cloud = PointCloud(positions, rng.integers(0, 256, (count, 3)).astype(np.uint8))
    try:
        index = build_map_index(cloud)
    except OptionsError:
        return
    assert index.num_starts >= 1
    assert decode_map_index(encode_map_index(index)).num_points == count


def test_a_flat_scan_becomes_a_map_or_is_refused_with_reason() -> None:
    rng = np.random.default_rng(0)
    positions = (rng.uniform(0, 4, (3000, 3)) * [1, 1, 0]).astype(np.float32)
    cloud = PointCloud(positions, rng.integers(0, 256, (3000, 3)).astype(np.uint8))
    try:
        assert build_map_index(cloud).num_starts >= 1
    except OptionsError:
        return


@pytest.mark.slow
def test_label_maps_give_every_label_its_own_code() -> None:
    palette = ((0, 0, 0), (255, 0, 0), (250, 30, 10), (0, 128, 255), (90, 90, 90))
    index = build_map_index(
        PaintedBox(seed=1, palette=palette).scan(6000), IndexOptions(color_kind="labels", spacing_m=1.0)
    )
    assert index.labels is not None
    assert len(index.labels.labels) == len(torch.unique(index.labels.codes, dim=0)) == 5
    gaps = torch.cdist(index.labels.codes, index.labels.codes) + torch.eye(5) * 9
    assert float(gaps.min()) > 0.3


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


@pytest.mark.slow
def test_survey_offsets_survive_to_the_last_bit(box: PaintedBox) -> None:
    offset = np.array([4_500_000.123456789, 5_400_000.987654321, 312.1])
    index = build_map_index(box.scan(2000, origin_offset=offset), IndexOptions(spacing_m=2.0))
    np.testing.assert_array_equal(decode_map_index(encode_map_index(index)).origin_offset, offset)


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


@pytest.mark.filterwarnings("ignore:invalid escape sequence:DeprecationWarning:pickletools")  # which tries to read them
def test_the_bytes_run_no_code(box_index: MapIndex) -> None:
    import pickletools

    data = encode_map_index(box_index)
    assert data[:4] == b"PLMI"
    with pytest.raises((ValueError, EOFError, UnicodeDecodeError, KeyError)):
        list(pickletools.genops(data))


def test_an_index_of_another_version_is_refused_and_looked_for_under_another_name(
    box_index: MapIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, digest = encode_map_index(box_index), index_config_digest(IndexOptions())
    for version in (INDEX_VERSION - 1, INDEX_VERSION + 1):
        with pytest.raises(IndexFormatError, match=f"expected version {INDEX_VERSION}.*{version}.*build it again"):
            decode_map_index(data[:4] + version.to_bytes(2, "little") + data[6:])
    monkeypatch.setattr("core.index.map_builder.INDEX_VERSION", INDEX_VERSION - 1)
    assert index_config_digest(IndexOptions()) != digest


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
    monkeypatch.setattr("core.config.index.CONTRAST", dataclasses.replace(CONTRAST, rows=8))
    assert IndexConfig().digest() != before


def test_what_only_queries_depend_on_is_not_in_the_digest() -> None:
    sections = (IndexConfig, StartsConfig, DescriptorConfig, FineViewConfig)
    names = {field.name for section in sections for field in dataclasses.fields(section)}
    assert not names & {field.name for field in dataclasses.fields(SearchConfig)}
