"""Places on Earth of projected coordinates; expected values come from pyproj's own factors and from EPSG's examples."""

import math

import pytest
from pyproj import CRS, Proj, Transformer

from panoloc.core.errors import OptionsError
from panoloc.core.georeference import coordinate_system
from tests.core.known import known

UTM_32 = "EPSG:25832"
# Grid positions far from and near to the middle of their zones.
PLACES = [
    (UTM_32, 640_000.0, 5_320_000.0),
    (UTM_32, 300_000.0, 5_930_000.0),
    ("EPSG:32756", 334_000.0, 6_252_000.0),  # Sydney, southern hemisphere
    ("EPSG:28992", 121_000.0, 487_000.0),  # Amsterdam: oblique stereographic
    ("EPSG:2154", 652_000.0, 6_862_000.0),  # Paris: Lambert conic
    ("EPSG:2263", 300_000.0, 64_000.0),  # New York, in US survey feet; given here in metres
]


@pytest.mark.parametrize(("code", "east", "north"), PLACES)
def test_convergence_and_scale_are_those_of_pyproj(code: str, east: float, north: float) -> None:
    place = known(coordinate_system(code).place((east, north, 12.0)))
    factors = Proj(CRS(code)).get_factors(place.longitude_deg, place.latitude_deg)
    assert place.convergence_deg == pytest.approx(factors.meridian_convergence, abs=0.001)
    assert place.scale == pytest.approx(factors.meridional_scale, abs=5e-6)  # datums differ in scale


def test_the_place_is_that_of_an_independent_transformation() -> None:
    place = known(coordinate_system(UTM_32).place((640_000.0, 5_320_000.0, 12.0)))
    longitude, latitude = Transformer.from_crs(UTM_32, "EPSG:4326", always_xy=True).transform(640_000.0, 5_320_000.0)
    assert (place.latitude_deg, place.longitude_deg) == pytest.approx((latitude, longitude), abs=1e-9)
    # Series of first order: the convergence is the longitude from the middle of the zone times the sine of the latitude.
    rough = (longitude - 9) * math.sin(math.radians(latitude))
    assert place.convergence_deg == pytest.approx(rough, abs=0.005)


def test_wkt_is_recognised_by_its_code_and_feet_are_converted() -> None:
    for version in ("WKT1_GDAL", "WKT2_2019"):
        assert coordinate_system(CRS(UTM_32).to_wkt(version)).definition == UTM_32
    assert coordinate_system("EPSG:2263").metres_per_unit == pytest.approx(1200 / 3937)


@pytest.mark.parametrize(
    ("text", "undulation", "height", "reference"),
    [
        (UTM_32, None, 100.0, "unknown"),
        (UTM_32, 46.0, 146.0, "ellipsoid"),
        ("EPSG:25832+7837", None, 100.0, "geoid"),
        ("EPSG:25832+7837", 46.0, 146.0, "ellipsoid"),
    ],
)
def test_heights_say_what_they_are_above(text: str, undulation: float | None, height: float, reference: str) -> None:
    place = known(coordinate_system(text).place((640_000.0, 5_320_000.0, 100.0), undulation))
    assert (place.height_m, place.height_reference) == (height, reference)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "UTM 32",
        "EPSG:4326",
        "EPSG:4978",
        "EPSG:99999",
        "+proj=utm +zone=32",
        "PROJCS[",
        "EPSG:5555;x",
        "x" * 70_000,
    ],
)
def test_what_is_no_projected_system_is_refused_with_what_was_expected(text: str) -> None:
    with pytest.raises(OptionsError, match="expected a projected coordinate system by EPSG code"):
        coordinate_system(text)


def test_positions_outside_of_a_system_have_no_place() -> None:
    assert coordinate_system(UTM_32).place((1e12, 1e12, 0.0)) is None
