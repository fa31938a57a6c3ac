"""The map index: what registration keeps, how it travels as bytes, and when it counts as another one."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.config import CONTRAST, DescriptorConfig, IndexConfig
from panoloc.core.errors import OptionsError
from panoloc.core.features.described_views import DescribedViews
from panoloc.core.map.map_builder import build_map_index, index_config_digest
from panoloc.core.map.map_codec import decode_map_index, encode_map_index
from panoloc.core.map.map_diagnostics import map_diagnostics
from panoloc.core.options import IndexOptions
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.built_maps import BOX, LABELLED, map_of
from tests.core.found_pose import known


class WithdrawnError(Exception):
    """What a caller may raise who no longer wants the work."""


def test_an_index_describes_its_scan_and_nothing_is_doubtful_about_it() -> None:
    index = map_of(BOX)
    assert index.num_points == index.num_points_read == 24_000
    assert index.num_starts == len(index.start_positions) == len(index.leaf_sizes)
    np.testing.assert_allclose(index.bounds, [(0, 0, 0), BOX.size_m], atol=0.02)
    assert 0.02 < index.spacing < 0.1
    assert index.labels is None
    assert bool((index.leaf_sizes > 0).all())
    assert list(map_diagnostics(index, IndexOptions(), index.num_points)) == []


def test_an_index_keeps_every_point_with_its_own_colour() -> None:
    cloud, index = BOX.scan(), map_of(BOX)
    rows = np.concatenate((cloud.positions, cloud.colors), axis=1)
    kept = np.concatenate((index.positions.numpy(), index.colors.numpy()), axis=1)
    np.testing.assert_array_equal(kept[np.lexsort(kept.T)], rows[np.lexsort(rows.T)])


@pytest.mark.slow
def test_registration_stops_when_its_progress_says_so() -> None:
    def cancel(stage: str, share: float) -> None:
        if stage == "rendering starts":
            raise WithdrawnError("withdrawn")

    with pytest.raises(WithdrawnError):
        build_map_index(BOX.scan(3000), IndexOptions(spacing_m=2.0), progress=cancel)


@pytest.mark.slow
def test_a_region_of_starts_is_given_in_the_scans_own_frame() -> None:
    offset = np.array([1000.0, 2000.0, 30.0])
    low, high = offset + np.array([1, 1, 0.8]), offset + np.array([3, 2.5, 1.9])
    options = IndexOptions(region=(tuple(low.tolist()), tuple(high.tolist())), spacing_m=0.9)
    index = build_map_index(BOX.scan(6000, origin_offset=offset), options)
    assert (index.start_positions >= low - 1e-4).all()
    assert (index.start_positions <= high + 1e-4).all()
    with pytest.raises(OptionsError, match="region"):
        build_map_index(BOX.scan(6000), options)


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


def test_an_index_read_back_differs_only_by_stated_rounding_and_is_not_rounded_again() -> None:
    index = map_of(BOX)
    data = encode_map_index(index)
    assert len(data) < 5_000_000
    back = decode_map_index(data)
    assert float((back.positions - index.positions).abs().max()) <= index.spacing / 32 + 1e-6
    for name in ("starts", "leaf_sizes", "sampled_shares"):
        assert torch.equal(getattr(back, name), getattr(index, name)), name
    rounded = [(back.colors, index.colors), (back.views.pictures, index.views.pictures)]
    for after, before in rounded:
        assert int((after.int() - before.int()).abs().max()) <= 255 / 63 / 2 + 1
    for field in dataclasses.fields(DescribedViews):
        before, after = getattr(index.views, field.name), getattr(back.views, field.name)
        assert (before.shape, before.dtype) == (after.shape, after.dtype), field.name
        assert field.name == "pictures" or torch.equal(before, after), field.name
    assert torch.equal(back.aliases.starts, index.aliases.starts)
    assert torch.equal(back.aliases.turns, index.aliases.turns)
    assert torch.equal(back.wall_axes, index.wall_axes)
    assert back.surface_thickness_m == index.surface_thickness_m
    assert (back.spacing, back.num_points_read) == (index.spacing, index.num_points_read)

    again = decode_map_index(encode_map_index(back))
    torch.testing.assert_close(again.positions, back.positions, atol=1e-5, rtol=0)
    assert torch.equal(again.colors, back.colors)
    assert torch.equal(again.views.pictures, back.views.pictures)


def test_label_codes_survive() -> None:
    index = build_map_index(LABELLED.scan(3000), IndexOptions(color_kind="labels", spacing_m=1.5))
    back = decode_map_index(encode_map_index(index))
    assert torch.equal(known(back.labels).labels, known(index.labels).labels.int())
    assert torch.equal(known(back.labels).codes, known(index.labels).codes)
    assert torch.equal(back.colors, index.colors)


# Digests.


def test_the_digest_changes_with_every_option_and_with_the_settings() -> None:
    options = [
        IndexOptions(),
        IndexOptions(starts_method="grid"),
        IndexOptions(spacing_m=0.4),
        IndexOptions(color_kind="labels"),
        IndexOptions(region=((0, 0, 0), (1, 1, 1))),
    ]
    digests = [index_config_digest(option) for option in options]
    digests.append(index_config_digest(IndexOptions(), IndexConfig(descriptors=DescriptorConfig(bins=6))))
    assert len(set(digests)) == len(digests)
    assert all(len(digest) == 16 and int(digest, 16) >= 0 for digest in digests)
    assert index_config_digest(IndexOptions()) == digests[0]


def with_one_setting_changed(config: Any) -> list[Any]:
    """Return the configurations in which one number is larger by one, at any depth."""
    if isinstance(config, int | float):
        return [config + 1]
    return [
        dataclasses.replace(config, **{field.name: other})
        for field in dataclasses.fields(config)
        for other in with_one_setting_changed(getattr(config, field.name))
    ]


def test_every_setting_of_the_index_is_in_the_digest(monkeypatch: pytest.MonkeyPatch) -> None:
    base = IndexConfig()
    plain, others = base.digest(), with_one_setting_changed(base)
    assert len(others) > 12
    for other in others:
        assert other.digest() != plain, other
    monkeypatch.setattr("panoloc.core.config.CONTRAST", dataclasses.replace(CONTRAST, rows=8))
    assert base.digest() != plain
