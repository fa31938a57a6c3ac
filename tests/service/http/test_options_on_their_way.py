"""From the JSON of a caller to the values that the algorithm takes."""

from typing import Any

from panoloc.core.options import Hints, IndexOptions, ScanOptions
from panoloc.service.http.schemas.maps import MapOptions
from panoloc.service.http.schemas.maps import ScanOptions as ScanSchema
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.jobs import RegisterOptions

BOX = {"min": [0, 0, 0], "max": [4, 5, 2.5]}


def hints_of(options: dict[str, Any]) -> Hints | None:
    return LocalizeOptions.model_validate(options).to_options(60).hints


def test_no_hints_are_no_hints() -> None:
    assert hints_of({}) is None
    assert hints_of({"hints": None}) is None
    assert hints_of({"hints": {"position_m": None, "radius_m": None}}) is None


def test_hints_arrive_as_the_algorithm_takes_them() -> None:
    hints = hints_of({"hints": {"position_m": [1, 2, 3], "radius_m": 5, "region": BOX, "upright": True}})
    assert hints == Hints(position_m=(1, 2, 3), radius_m=5, region=((0, 0, 0), (4, 5, 2.5)), upright=True)


def test_a_query_has_the_time_that_its_caller_names_and_each_picture_once() -> None:
    given = {"artifacts": ["overlay", "score_map_2d", "overlay"], "top_k": 3, "frame": "unity", "method": "paper"}
    options = LocalizeOptions.model_validate(given).to_options(60)
    assert (options.timeout_s, options.artifacts) == (60, ("overlay", "score_map_2d"))
    assert (options.top_k, options.frame, options.method) == (3, "unity", "paper")
    assert LocalizeOptions.model_validate({"timeout_s": 7}).to_options(60).timeout_s == 7


def test_a_scan_is_read_as_its_uploader_said() -> None:
    options = MapOptions.model_validate({"unit": "mm", "up_axis": "y", "color_kind": "labels"}).to_options()
    assert options.scan == ScanOptions(unit="mm", up_axis="y", color_kind="labels")
    assert options.index == IndexOptions(color_kind="labels")


def test_starts_on_a_grid_in_a_region() -> None:
    starts = {"method": "grid", "spacing_m": 1.0, "region": BOX}
    options = MapOptions.model_validate({"starts": starts}).to_options().index
    assert (options.starts_method, options.spacing_m, options.region) == ("grid", 1.0, ((0, 0, 0), (4, 5, 2.5)))


def test_without_options_a_map_is_built_by_the_algorithms_defaults() -> None:
    assert MapOptions.model_validate({}).to_options() == RegisterOptions(ScanOptions(), IndexOptions())


def test_a_newer_scan_keeps_the_options_that_are_left_out() -> None:
    former = MapOptions.model_validate({"unit": "cm", "starts": {"method": "grid", "region": BOX}}).to_options()
    given = ScanSchema.model_validate({"up_axis": "y", "starts": {"spacing_m": 2}})
    assert given.over(former).scan == ScanOptions(unit="cm", up_axis="y")
    assert given.over(former).index == IndexOptions("octree", 2)
