"""Options from callers: what is valid comes out complete, what is not names its field. And settings, and keys."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from panoloc.service.errors import InvalidOptionsError, MalformedRequestError
from panoloc.service.http.schemas.examples import MAP_OPTIONS_EXAMPLE, OPTIONS_EXAMPLE
from panoloc.service.http.schemas.maps import MapOptions, name_of_file
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.http.validation import parse_json
from panoloc.service.keys.caller import ALL_SCOPES
from panoloc.service.keys.key_ring import KeyRing
from panoloc.service.settings import Settings

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


@given(st.floats())
def test_a_radius_is_a_positive_number(radius: float) -> None:
    text = json.dumps({"hints": {"position_m": [0, 0, 0], "radius_m": radius}}).encode()
    if math.isfinite(radius) and 0 < radius <= 1e6:
        assert parse_json(LocalizeOptions, text, "options").hints is not None
    else:
        with pytest.raises(InvalidOptionsError, match=r"hints\.radius_m"):
            parse_json(LocalizeOptions, text, "options")


def test_the_examples_of_the_contract_are_valid() -> None:
    parse_json(LocalizeOptions, json.dumps(OPTIONS_EXAMPLE).encode(), "options")
    parse_json(MapOptions, json.dumps(MAP_OPTIONS_EXAMPLE).encode(), "options")


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


def test_a_key_may_do_what_its_scope_says(tmp_path: Path) -> None:
    keys = KeyRing("all-of-it, only-look:read, writes-too:write, only-ask:localize", tmp_path)
    assert scopes_of(keys, "all-of-it") == ALL_SCOPES
    assert scopes_of(keys, "only-look") == {"read", "localize"}
    assert scopes_of(keys, "only-ask") == {"localize"}
    assert scopes_of(keys, "writes-too") == {"read", "localize", "write"}
    assert keys.find("only-loo") is None
    assert not KeyRing("", tmp_path).required


def scopes_of(keys: KeyRing, key: str) -> frozenset[str]:
    caller = keys.find(key)
    assert caller is not None
    assert caller.tenant is None
    return frozenset[str](caller.scopes)


@pytest.mark.parametrize("keys", ["short", "long-enough:admin", "ünicode-key"])
def test_a_wrong_key_in_the_settings_is_named_but_not_shown(keys: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Settings(api_keys=keys)
    message = caught.value.errors()[0]["msg"]
    assert "key 1" in message
    assert keys.partition(":")[0] not in message


def test_settings_come_from_the_environment_and_arguments_win(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOLOC_PORT", "9001")
    monkeypatch.setenv("PANOLOC_MAX_MAPS", "7")
    monkeypatch.setenv("RAY_ADDRESS", "ray://head:10001")
    monkeypatch.setenv("PANOLOC_REDIS_URL", "")
    settings = Settings(port=9002)
    assert (settings.port, settings.max_maps) == (9002, 7)
    assert settings.ray_address == "ray://head:10001"
    assert settings.redis_url is None
    monkeypatch.setenv("PANOLOC_PORT", "no number")
    with pytest.raises(ValidationError, match="port"):
        Settings()


def test_keys_are_not_printed_with_the_settings() -> None:
    assert "secret-key" not in repr(Settings(api_keys="secret-key"))
