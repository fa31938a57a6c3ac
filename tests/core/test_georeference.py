"""Places and poses on Earth, against pyproj, examples of EPSG, and golden numbers worked out elsewhere."""

import numpy as np
import pytest
from pyproj import CRS, Proj, Transformer

from panoloc.core.earth.geopose import geopose_of
from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.errors import OptionsError
from panoloc.core.exports.frames import photo_angles
from panoloc.core.geometry.pose import Pose
from tests.core.exports.tours import rotation_of
from tests.core.found_pose import known
from tests.properties.strategies import matrix_of

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
def test_the_convergence_is_that_of_pyproj(code: str, east: float, north: float) -> None:
    place = known(coordinate_system(code).place((east, north, 12.0)))
    factors = Proj(CRS(code)).get_factors(place.longitude_deg, place.latitude_deg)
    assert place.convergence_deg == pytest.approx(factors.meridian_convergence, abs=0.001)


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


GEOGRAPHIC, GEOCENTRIC = "EPSG:4326", "EPSG:4978"


@pytest.mark.parametrize(
    "text",
    [GEOGRAPHIC, GEOCENTRIC, "", "UTM 32", "EPSG:99999", "+proj=utm +zone=32", "PROJCS[", "EPSG:5555;x", "x" * 70_000],
)
def test_what_is_no_projected_system_is_refused_with_what_was_expected(text: str) -> None:
    with pytest.raises(OptionsError, match="expected a projected coordinate system by EPSG code"):
        coordinate_system(text)


@pytest.mark.parametrize(
    ("code", "east", "north", "is_used"),
    [
        (UTM_32, 940_000.0, 5_320_000.0, True),  # in the next zone, but in the country
        (UTM_32, 4_640_000.0, 5_320_000.0, False),
        (UTM_32, 6.0, 4.0, False),  # of a site of its own
        ("EPSG:32632", 6.0, 4.0, False),
        ("EPSG:28992", 6.0, 4.0, False),
        ("EPSG:3857", 1_490_000.0, 6_890_000.0, True),  # all around the Earth
        ("EPSG:3832", 1_000_000.0, -2_000_000.0, True),  # on both sides of the 180th meridian
        ("EPSG:3832", -17_000_000.0, -2_000_000.0, False),
    ],
)
def test_a_system_is_used_in_its_area_and_a_little_beyond(code: str, east: float, north: float, is_used: bool) -> None:
    assert (coordinate_system(code).place((east, north, 0.0)) is not None) == is_used


@pytest.mark.parametrize(
    ("position_m", "said"),
    [
        ((5_333_000.0, 691_000.0, 500.0), "with x and y exchanged it would be inside; name"),
        ((32_691_000.0, 5_333_000.0, 500.0), "without the zone before x it would be inside; name"),
        ((691_000.0, 500.0, 5_333_000.0), "lies outside its area; name"),
    ],
)
def test_what_is_usually_wrong_with_a_position_outside_of_a_system_is_said(
    position_m: tuple[float, float, float], said: str
) -> None:
    system = coordinate_system("EPSG:25832")
    assert system.place(position_m) is None
    assert said in system.why_outside(position_m)


def test_positions_outside_of_a_system_have_no_place() -> None:
    assert coordinate_system(UTM_32).place((1e12, 1e12, 0.0)) is None


# GeoPose.


def camera_at(position_m: tuple[float, float, float], yaw_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """Return `map_from_camera` turned by Rz(yaw) · Ry(pitch) · Rx(roll)."""
    return Pose(rotation_of(90 - yaw_deg, -pitch_deg, roll_deg), np.array(position_m))


GOLDEN = camera_at((1.25, -2.5, 1.6), 52.5, 12.25, 4.75)
_DEGREE, _METRE = 'ANGLEUNIT["degree",0.0174532925199433]', 'LENGTHUNIT["metre",1]'
# UTM zone 32 of ETRS89 with heights above its ellipsoid: three axes, for which EPSG has no code.
_UTM_WITH_HEIGHTS = f"""PROJCRS["ETRS89 / UTM 32N, ellipsoidal heights",
BASEGEOGCRS["ETRS89",DATUM["European Terrestrial Reference System 1989",
ELLIPSOID["GRS 1980",6378137,298.257222101,{_METRE}]],PRIMEM["Greenwich",0,{_DEGREE}]],
CONVERSION["UTM zone 32N",METHOD["Transverse Mercator",ID["EPSG",9807]],
PARAMETER["Latitude of natural origin",0,{_DEGREE}],PARAMETER["Longitude of natural origin",9,{_DEGREE}],
PARAMETER["Scale factor at natural origin",0.9996,SCALEUNIT["unity",1]],
PARAMETER["False easting",500000,{_METRE}],PARAMETER["False northing",0,{_METRE}]],
CS[Cartesian,3],AXIS["(E)",east,ORDER[1],{_METRE}],AXIS["(N)",north,ORDER[2],{_METRE}],
AXIS["ellipsoidal height (h)",up,ORDER[3],{_METRE}]]"""
ORIGIN = {"latitude_deg": 47.7, "longitude_deg": -122.3, "height_m": 11.5, "heading_deg": 0.0}


def test_the_golden_pose_has_its_golden_geopose() -> None:
    found = known(geopose_of(ORIGIN, GOLDEN))
    assert list(found["position"]) == ["lat", "lon", "h"]
    assert list(found["position"].values()) == pytest.approx([47.699977515, -122.299983346, 13.100000612], abs=2e-9)
    turned = [-0.010196979, 0.113835940, 0.435420455, 0.892942567]
    assert [found["quaternion"][axis] for axis in "xyzw"] == pytest.approx(turned, abs=1e-9)


def topocentric(place: dict[str, float]) -> Transformer:
    """Return what takes WGS 84 (longitude and latitude in degrees, height) to metres east, north and up of a place."""
    return Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 +step +proj=topocentric "
        f"+ellps=WGS84 +lat_0={place['lat']:.15f} +lon_0={place['lon']:.15f} +h_0={place['h']:.9f}"
    )


def test_every_pose_in_every_turned_map_is_where_proj_has_it_and_its_axes_point_where_proj_has_them() -> None:
    random = np.random.default_rng(3)
    for _ in range(30):
        yaw, roll, heading = random.uniform(-180, 180, 3)
        pitch = random.choice([-90.0, 90.0, random.uniform(-90, 90)])
        origin = dict(zip(("lat", "lon", "h"), random.uniform([-89, -180, -50], [89, 180, 3000]).tolist(), strict=True))
        camera = camera_at(tuple(random.normal(size=3) * 300), yaw, pitch, roll)
        georeference = {"latitude_deg": origin["lat"], "longitude_deg": origin["lon"], "height_m": origin["h"]}
        found = known(geopose_of({**georeference, "heading_deg": heading}, camera))
        # The camera, and a metre along each of its axes: turned clockwise by the heading, then taken from there to here by PROJ.
        angle = np.radians(-heading)
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        points = turn @ np.column_stack((camera.position, camera.position[:, None] + camera.rotation))
        longitude, latitude, height = topocentric(origin).transform(
            points[0], points[1], points[2], direction="INVERSE"
        )
        assert list(found["position"].values()) == pytest.approx([latitude[0], longitude[0], height[0]], abs=1e-6)
        here = np.array(topocentric(found["position"]).transform(longitude, latitude, height))
        np.testing.assert_allclose(here[:, 0], 0, atol=0.001)
        quaternion = np.array([found["quaternion"][axis] for axis in "xyzw"])
        np.testing.assert_allclose(matrix_of(quaternion), here[:, 1:] - here[:, :1], atol=1e-6)
        assert quaternion[3] >= 0


@pytest.mark.parametrize("system", ["EPSG:25832", "EPSG:25832+7837"])
def test_heights_above_the_geoid_are_raised_by_its_undulation(system: str) -> None:
    pose = camera_at((640_000.0, 5_320_000.0, 412.0), 30.0, -5.0, 2.0)
    found = known(geopose_of({"coordinate_system": system, "geoid_undulation_m": 46.2}, pose))
    # By PROJ: echo 640000 5320000 458.2 | cs2cs EPSG:25832 EPSG:4979
    assert list(found["position"].values()) == pytest.approx([48.017943985, 10.877474808, 458.2], abs=2e-9)
    ellipsoidal = camera_at((640_000.0, 5_320_000.0, 458.2), 30.0, -5.0, 2.0)
    assert found == geopose_of({"coordinate_system": _UTM_WITH_HEIGHTS}, ellipsoidal)


def test_a_grid_is_turned_by_its_convergence_and_heights_have_to_be_ellipsoidal() -> None:
    pose = camera_at((640_000.0, 5_320_000.0, 412.0), 90.0, 0.0, 0.0)
    assert geopose_of({"coordinate_system": "EPSG:25832"}, pose) is None  # of unknown height
    assert geopose_of({"coordinate_system": "EPSG:25832+7837"}, pose) is None  # above the geoid
    found = known(geopose_of({"coordinate_system": _UTM_WITH_HEIGHTS, "geoid_undulation_m": 46.2}, pose))
    assert found["position"]["h"] == 412.0  # as it is
    x, y, z, w = (found["quaternion"][axis] for axis in "xyzw")
    forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    # Grid north is 1.4 degrees clockwise of true north there, as the series says: (longitude - 9) sin(latitude).
    heading = np.degrees(np.arctan2(forward[0], forward[1]))
    rough = (found["position"]["lon"] - 9) * np.sin(np.radians(found["position"]["lat"]))
    assert heading == pytest.approx(rough, abs=0.01)
    assert photo_angles(rotation_of(heading, 0, 0)).heading_deg == pytest.approx(heading)
