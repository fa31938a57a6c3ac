"""Messages about wrong options use the words of the service, not those of its libraries."""

import pytest

from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.schemas.maps import MapOptions, MapPatch
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.http.validation import parse_json


@pytest.mark.parametrize(
    ("model", "text", "said"),
    [
        (LocalizeOptions, '{"timeout_s": -3}', "timeout_s: expected more than 0.0, got -3. "),
        (LocalizeOptions, '{"top_k": "x"}', "top_k: expected a whole number, got 'x'. "),
        (
            LocalizeOptions,
            '{"hints": {"position_m": [1, 2]}}',
            "hints.position_m: expected 3 or more items, got [1, 2]. ",
        ),
        (MapOptions, '{"unit": "furlong"}', "unit: expected 'm', 'cm', 'mm' or 'ft', got 'furlong'. "),
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
