"""Options from callers: what is valid reaches the algorithm complete, what is not names its field in the words of the service."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel

from panoloc.core.options import Hints, IndexOptions, ScanOptions
from panoloc.service.answer import Localization
from panoloc.service.errors import InvalidOptionsError, MalformedRequestError
from panoloc.service.http.schemas import examples
from panoloc.service.http.schemas.batches import Batch, BatchOptions, BatchPage
from panoloc.service.http.schemas.geopose import GeoPoseRequest
from panoloc.service.http.schemas.known_map import Map, MapChanges
from panoloc.service.http.schemas.maps import MapOptions, MapPatch, name_of_file
from panoloc.service.http.schemas.maps import ScanOptions as ScanSchema
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.http.validation import parse_json
from panoloc.service.jobs import RegisterOptions

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
COORDINATE = st.floats(-1e6, 1e6)


def refusal_of(model: type[Any], data: bytes) -> InvalidOptionsError | MalformedRequestError | None:
    try:
        parse_json(model, data, "options")
    except (InvalidOptionsError, MalformedRequestError) as error:
        return error
    return None


@given(JSON)
def test_any_json_is_either_read_or_refused_by_its_field(value: Any) -> None:
    data = json.dumps(value).encode()
    refused = refusal_of(LocalizeOptions, data)
    if isinstance(refused, InvalidOptionsError):
        assert refused.fields
        assert all(each["field"] and each["message"] for each in refused.fields)
    else:
        assert set(value) <= set(LocalizeOptions.model_fields)
        json.dumps(parse_json(LocalizeOptions, data, "options").model_dump(mode="json"), allow_nan=False)


@given(st.binary())
def test_any_bytes_are_read_or_refused_with_a_message(data: bytes) -> None:
    refused = refusal_of(MapOptions, data)
    assert refused is None or str(refused).startswith(("options", "name"))


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ('{"top_k": 2, "top_k": 3}', "top_k"),
        ('{"hints": {"position_m": [0, 0, 0], "radius_m": 1, "radius_m": 2}}', "radius_m"),
        ('{"hints": {"upright": true}, "frame": "ros", "hints": {"upright": false}}', "hints"),
    ],
)
def test_a_name_that_stands_twice_is_refused_whichever_a_reader_would_take(text: str, field: str) -> None:
    refused = refusal_of(LocalizeOptions, text.encode())
    assert isinstance(refused, InvalidOptionsError)
    assert refused.fields[0]["field"] == field
    assert "2 times" in str(refused)


@given(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_a_region_has_min_below_max_on_every_axis(low: tuple[float, ...], high: tuple[float, ...]) -> None:
    text = json.dumps({"hints": {"region": {"min": low, "max": high}}}).encode()
    if all(a < b for a, b in zip(low, high, strict=True)):
        region = parse_json(LocalizeOptions, text, "options").model_dump(mode="json")["hints"]["region"]
        assert region == {"min": list(low), "max": list(high)}
    else:
        with pytest.raises(InvalidOptionsError, match=r"hints\.region"):
            parse_json(LocalizeOptions, text, "options")


@pytest.mark.parametrize(
    ("model", "example"),
    [
        (LocalizeOptions, examples.OPTIONS_EXAMPLE),
        (LocalizeOptions, examples.SESSION_EXAMPLE),
        (MapOptions, examples.MAP_OPTIONS_EXAMPLE),
        (GeoPoseRequest, examples.GEOPOSE_REQUEST_EXAMPLE),
        (Localization, examples.LOCALIZATION_EXAMPLE),
        (Map, examples.MAP_EXAMPLE),
        (MapChanges, examples.CHANGES_EXAMPLE),
        (Batch, examples.BATCH_EXAMPLE),
        (BatchPage, examples.BATCH_PAGE_EXAMPLE),
    ],
)
def test_the_examples_of_the_contract_are_valid_and_complete(model: type[BaseModel], example: dict[str, Any]) -> None:
    shown = model.model_validate(example)
    assert shown.model_dump(mode="json", exclude_unset=True).keys() <= set(model.model_fields)


@pytest.mark.parametrize("name", ["", " ", "a\nb", "x" * 201])
def test_a_name_can_be_shown(name: str) -> None:
    with pytest.raises(InvalidOptionsError, match="name"):
        parse_json(MapOptions, json.dumps({"name": name}).encode(), "options")


@given(st.text() | st.just("x" * 300) | st.just("a\x01b.ply"))
def test_a_map_that_is_named_after_its_file_bears_a_name_that_could_be_given(file_name: str) -> None:
    name = name_of_file(file_name)
    if name:
        given_name = parse_json(MapOptions, json.dumps({"name": name}).encode(), "options").name
        assert given_name == name


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ('{"method": "slow"}', "method"),
        ('{"timeout_s": NaN}', "timeout_s"),
        ('{"artifacts": ["all"]}', "artifacts.0"),
        ('{"hints": {"position_m": [1, 2, "x"]}}', "hints.position_m.2"),
        ('{"hints": {"radius_m": 5}}', "hints"),
        ('{"hints": {"position_m": [1, 2, 3], "radius_m": 0}}', "hints.radius_m"),
        ('{"hints": {"region": {"min": [0, 0, 0], "max": [1, 0, 1]}}}', "hints.region"),
        ('{"hints": {"heading_tolerance_deg": 5}}', "hints"),
        ('{"hints": {"heading_deg": 5, "heading_tolerance_deg": 0}}', "hints.heading_tolerance_deg"),
        ('{"hints": {"max_tilt_deg": 181}}', "hints.max_tilt_deg"),
        ("[]", "options"),
    ],
)
def test_an_option_out_of_range_is_named(options: str, field: str) -> None:
    refused = refusal_of(LocalizeOptions, options.encode())
    assert isinstance(refused, InvalidOptionsError)
    assert refused.fields[0]["field"] == field
    assert field in str(refused)
    assert ", got " in str(refused)


@pytest.mark.parametrize(
    ("model", "text", "said"),
    [
        (LocalizeOptions, '{"timeout_s": -3}', "timeout_s: expected more than 0.0, got -3. "),
        (LocalizeOptions, '{"top_k": "x"}', "top_k: expected a whole number, got 'x'. "),
        (BatchOptions, '{"session": {}}', "session: expected null, for this request does not take it, got {}. "),
        (LocalizeOptions, '{"top_k": true}', "top_k: expected a whole number, got true. "),
        (LocalizeOptions, '{"hints": {"upright": "no"}}', "hints.upright: expected true or false, got 'no'. "),
        (LocalizeOptions, '{"hints": {"heading_deg": true}}', "hints.heading_deg: expected a number, got true. "),
        (
            LocalizeOptions,
            '{"hints": {"position_m": ["1", 2, null]}}',
            "hints.position_m.0: expected a number, got '1'; hints.position_m.2: expected a number, got null. ",
        ),
        (
            LocalizeOptions,
            '{"session": {"position_noise_m": {"x": true}}}',
            'session.position_noise_m: expected a number, got {"x": true}. ',
        ),
        (
            LocalizeOptions,
            '{"hints": {"position_m": [1, 2]}}',
            "hints.position_m: expected 3 or more items, got [1, 2]. ",
        ),
        (MapOptions, '{"name": "a\\u0000b"}', "name: expected text without control characters"),
        (MapOptions, '{"unit": "furlong"}', "unit: expected 'm', 'cm', 'mm', 'ft', 'us-ft' or 'auto', got 'furlong'. "),
        (
            MapOptions,
            '{"unt": "m"}',
            "unt: expected no field of this name, perhaps you mean unit, got 'm'. ",
        ),
        (
            MapOptions,
            '{"furlongs": "m"}',
            "furlongs: expected no field of this name, see /docs for the fields, got 'm'. ",
        ),
        (
            LocalizeOptions,
            '{"cameras": [{"model": "pinhole", "width": 640, "hfov": 60}]}',
            "cameras.0.width: expected no field of this name, perhaps you mean width_px, got 640; "
            "cameras.0.hfov: expected no field of this name, perhaps you mean hfov_deg, got 60. ",
        ),
        (
            LocalizeOptions,
            '{"hfov_deg": 69, "radius": 2, "position": null}',
            "hfov_deg: expected no field of this name, perhaps you mean cameras.hfov_deg, got 69; "
            "radius: expected no field of this name, perhaps you mean hints.radius_m, got 2; "
            "position: expected no field of this name, perhaps you mean hints.position_m, got null. ",
        ),
        (
            LocalizeOptions,
            '{"hints": {"region": {"min": [0, 0, 0], "max": [1, 1, 1], "mx": [1, 1, 1]}}}',
            "hints.region.mx: expected no field of this name, perhaps you mean max, got [1, 1, 1]. ",
        ),
        (MapPatch, '{"coordinate_system": "EPSG:1"}', "coordinate_system: expected a projected coordinate system"),
    ],
)
def test_a_message_says_what_was_expected_and_what_came(
    model: type[LocalizeOptions] | type[MapOptions] | type[MapPatch], text: str, said: str
) -> None:
    with pytest.raises(InvalidOptionsError) as caught:
        parse_json(model, text.encode(), "options")
    assert str(caught.value).startswith(said)
    for words in ("Input should", "valid integer", "permitted", "validation"):
        assert words not in str(caught.value)


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
