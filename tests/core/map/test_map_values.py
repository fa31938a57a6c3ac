"""What an index tells of itself, on one that is made by hand, and what is doubtful about it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.features.described_views import DescribedViews
from panoloc.core.features.patch_descriptors import pooled
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.map.aliases import Aliases
from panoloc.core.map.map_diagnostics import map_diagnostics
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import ColorKind, IndexOptions
from tests.core.found_pose import known

NUM_POINTS, NUM_STARTS, NUM_PATCHES, SIZE, BINS, ROWS, MOST_ALIASES = 1200, 3, 128, 7, 27, 8, 2
OFFSET = np.array([1000.5, -2000.25, 30.0])


def made(labels: bool = False) -> MapIndex:
    """Return an index whose points fill a box of 4 x 3 x 2 m, with three starts inside."""
    random = torch.Generator().manual_seed(0)
    positions = torch.rand((NUM_POINTS, 3), generator=random) * torch.tensor([4.0, 3.0, 2.0])
    positions[:2] = torch.tensor([[0.0, 0.0, 0.0], [4.0, 3.0, 2.0]])
    # Of labels that a photo shows in nearly these colours.
    codes = LabelCodes(torch.tensor([[0, 0, 0], [10, 20, 30]]), torch.tensor([[0.0, 0.5, 1.0], [1.0, 0.25, 0.0]]))
    colors = torch.tensor([[0, 0, 0], [10, 20, 32]], dtype=torch.uint8).repeat(NUM_POINTS // 2, 1)
    return MapIndex(
        positions=positions,
        colors=colors,
        origin_offset=OFFSET,
        spacing=0.04,
        starts=torch.tensor([[1.0, 1.0, 1.0], [2.0, 1.5, 1.0], [3.0, 2.0, 1.5]]),
        leaf_sizes=torch.tensor([0.5, 0.25, 0.125]),
        sampled_shares=torch.tensor([0.2, 0.9, 0.5]),
        labels=codes if labels else None,
        num_points_read=5000,
        views=DescribedViews(
            torch.randint(-31, 32, (NUM_STARTS, NUM_PATCHES, SIZE), generator=random).to(torch.int8),
            torch.rand(NUM_STARTS, generator=random),
            torch.randn((BINS, SIZE), generator=random),
            torch.rand((NUM_STARTS, NUM_PATCHES), generator=random).half(),
            torch.randint(0, 256, (NUM_STARTS, ROWS, 2 * ROWS, 3), generator=random).byte(),
            torch.rand((NUM_STARTS, ROWS, 2 * ROWS), generator=random) > 0.1,
        ),
        aliases=Aliases(torch.tensor([[2, -1], [-1, -1], [0, 1]], dtype=torch.int32), torch.rand((NUM_STARTS, 2))),
        wall_axes=torch.tensor([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]),
        surface_thickness_m=0.007,
    )


def test_places_are_told_in_the_scan_s_own_frame() -> None:
    index = made()
    assert (index.num_points, index.num_starts) == (NUM_POINTS, NUM_STARTS)
    lower, upper = index.bounds
    np.testing.assert_array_equal(lower, OFFSET)
    np.testing.assert_array_equal(upper, OFFSET + np.array([4, 3, 2]))
    np.testing.assert_array_equal(index.start_positions, OFFSET + made().starts.numpy())
    assert {each.dtype for each in (lower, upper, index.start_positions)} == {np.dtype("f8")}


def test_the_memory_of_an_index_is_that_of_its_arrays_and_of_what_a_query_adds() -> None:
    points = NUM_POINTS * (3 * 4 + 3)
    starts = NUM_STARTS * (3 * 4 + 4 + 4)
    aliases = NUM_STARTS * MOST_ALIASES * (4 + 4)
    views = NUM_STARTS * (NUM_PATCHES * (SIZE + 2) + 4 + ROWS * 2 * ROWS * (3 + 1)) + 4 * BINS * SIZE
    # 40 bytes of a point to render, a quarter and a sixteenth of the descriptors as floats, and how they spread.
    added = 40 * NUM_POINTS + 4 * NUM_STARTS * (NUM_PATCHES * SIZE // 4 + NUM_PATCHES * SIZE // 16 + SIZE**2)
    assert made().num_bytes == points + starts + aliases + 4 * 3 * 3 + views + added


def test_colours_are_shown_as_scanned_and_labels_by_their_codes() -> None:
    index, labelled = made(), made(labels=True)
    torch.testing.assert_close(index.canonical_cloud_colors(), index.colors.float() / 255)
    torch.testing.assert_close(index.render_cloud.colors[:NUM_POINTS, :3], index.colors.float() / 255)
    expected = known(labelled.labels).codes.repeat(NUM_POINTS // 2, 1)
    torch.testing.assert_close(labelled.canonical_cloud_colors(), expected)


def test_what_a_query_adds_is_made_once_and_serves_outside_of_inference() -> None:
    index = made()
    with torch.inference_mode():
        cloud, spreads = index.render_cloud, index.views.spreads
        halved, quartered = (index.views.descriptors(halvings) for halvings in (1, 2))
    assert index.render_cloud is cloud
    assert index.views.spreads is spreads
    assert (index.views.descriptors(1) is halved, index.views.descriptors(2) is quartered) == (True, True)
    assert not any(each.is_inference() for each in (cloud.positions, spreads, halved.values, quartered.values))
    values, weights = index.views.steps * index.views.scale[:, None, None], index.views.weights.float()
    torch.testing.assert_close(spreads, torch.einsum("tp,tpd,tpe->tde", weights, values, values))
    for found in (halved, quartered):
        values, weights = pooled(values, weights)
        torch.testing.assert_close(found.values, values)
        torch.testing.assert_close(found.weights, weights)
        assert torch.equal(found.basis, index.views.basis)


@pytest.mark.parametrize("labels", [False, True])
def test_an_index_moves_to_a_device_with_all_its_arrays(labels: bool) -> None:
    moved = made(labels).to("meta")
    arrays = [moved.positions, moved.colors, moved.starts, moved.leaf_sizes, moved.sampled_shares]
    views = moved.views
    arrays += [views.steps, views.scale, views.basis, views.weights, views.pictures, views.seen]
    arrays += [moved.aliases.starts, moved.aliases.turns, moved.wall_axes]
    if labels:
        assert moved.labels is not None
        arrays += [moved.labels.labels, moved.labels.codes]
    assert {array.device.type for array in arrays} == {"meta"}
    assert (moved.labels is not None) is labels
    assert (moved.spacing, moved.num_points_read) == (0.04, 5000)
    assert moved.views.steps.shape == (NUM_STARTS, NUM_PATCHES, SIZE)


# What is doubtful.


def found(
    index: MapIndex, options: IndexOptions | None = None, num_points_given: int = NUM_POINTS
) -> list[tuple[str, str, str]]:
    """Return code, severity and message of all that is doubtful."""
    told = map_diagnostics(index, options or IndexOptions(), num_points_given)
    return [(each.code, each.severity, each.message) for each in told]


def assert_told(told: list[tuple[str, str, str]], code: str, severity: str, is_told: bool, message: str) -> None:
    assert [each[:2] for each in told] == [(code, severity)] * is_told
    assert all(message in each[2] for each in told)


def region(low: tuple[float, ...], high: tuple[float, ...]) -> IndexOptions:
    """Return the options of a region in the axes of the index."""
    return IndexOptions(region=(tuple((OFFSET + low).tolist()), tuple((OFFSET + high).tolist())))


def test_nothing_is_doubtful_about_a_good_map() -> None:
    assert found(made()) == found(made(), region((0.0, 0.25, 0.5), (4.0, 2.25, 1.5))) == []


def test_points_that_were_merged_are_told_with_the_distance() -> None:
    message = "40,000 points became 1,200: those closer together than about 4.0 cm were merged"
    assert_told(found(made(), num_points_given=40_000), "merged_points", "info", True, message)


@pytest.mark.parametrize(("number", "is_few"), [(999, True), (1000, False)])
def test_fewer_than_a_thousand_points_are_few(number: int, is_few: bool) -> None:
    some = replace(made(), positions=made().positions[:number], colors=made().colors[:number])
    assert_told(found(some, num_points_given=number), "few_points", "warning", is_few, "has only 999 points; ")


@pytest.mark.parametrize(("share", "is_little"), [(0.0996, True), (0.1, False)])
def test_a_best_start_that_sees_less_than_a_tenth_sees_little(share: float, is_little: bool) -> None:
    shares = torch.tensor([0.01, share, 0.02], dtype=torch.float64)
    message = "From the best of the 3 starts the scan covers 10.0% of the view; at least 10% is expected."
    assert_told(found(replace(made(), sampled_shares=shares)), "starts_see_little", "warning", is_little, message)


@pytest.mark.parametrize(
    ("num_others", "color_kind", "is_said"),
    [(0, "rgb", True), (59, "rgb", True), (61, "rgb", False), (0, "labels", False)],
)
def test_a_scan_with_hardly_any_colours_says_so_and_labels_may_be_few(
    num_others: int, color_kind: ColorKind, is_said: bool
) -> None:
    colors = torch.full((NUM_POINTS, 3), 124, dtype=torch.uint8)
    colors[::3] += 8
    colors[:num_others] = torch.tensor([200, 10, 10], dtype=torch.uint8)
    told = found(replace(made(), colors=colors), IndexOptions(color_kind=color_kind))
    assert_told(told, "hardly_any_colors", "warning", is_said, "have nearly the same colour (124, 124, 124)")


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("beyond", ["below", "above"])
def test_a_region_that_reaches_beyond_the_scan_is_told_with_the_scan_s_bounds(axis: int, beyond: str) -> None:
    low, high = np.full(3, 0.5), np.array([3.0, 2.5, 1.75])
    if beyond == "below":
        low[axis] -= 0.6
    else:
        high[axis] += 1.6
    message = "beyond the scan ((1000.50, -2000.25, 30.00) to (1004.50, -1997.25, 32.00), metres)"
    assert_told(found(made(), region(tuple(low), tuple(high))), "region_outside_scan", "info", True, message)


def test_starts_outside_of_the_scan_are_counted() -> None:
    starts = made().starts.clone()
    starts[0, 1], starts[2, 2] = -0.1, 2.1
    told = found(replace(made(), starts=starts), region((-0.5, -0.75, 0.0), (3.5, 2.25, 3.0)))
    assert_told(told, "region_outside_scan", "warning", True, "2 of 3 starts lie outside of the scan ((1000.50, ")
