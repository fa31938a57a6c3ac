"""GeoPose: against golden numbers worked out elsewhere, and against the matrices of the exports."""

import numpy as np
import pytest

from panoloc.core.exports.angles import photo_angles
from panoloc.core.exports.geodesy import earth_pose
from panoloc.core.exports.tour import Georeference
from panoloc.core.geometry.pose import Pose, quaternion_of
from panoloc.core.geopose import MapPose, geopose_of
from tests.core.exports.tours import rotation_of
from tests.core.known import known

GOLDEN = MapPose((1.25, -2.5, 1.6), 52.5, 12.25, 4.75)
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


def test_every_pose_in_every_turned_map_is_that_of_the_exports() -> None:
    random = np.random.default_rng(3)
    for _ in range(100):
        yaw, roll = random.uniform(-180, 180, 2)
        pitch = random.choice([-90.0, 90.0, random.uniform(-90, 90)])
        position = random.normal(size=3) * 300
        place = Georeference(*random.uniform([-89, -180, -50, 0], [89, 180, 3000, 360]))
        found = known(geopose_of(vars(place), MapPose(tuple(position), yaw, pitch, roll)))
        expected = earth_pose(place, Pose(rotation_of(90 - yaw, -pitch, roll), position))
        at = [expected.latitude_deg, expected.longitude_deg, expected.height_m]
        assert list(found["position"].values()) == pytest.approx(at, abs=1e-6)
        quaternion = np.array([found["quaternion"][axis] for axis in "xyzw"])
        assert abs(quaternion @ quaternion_of(expected.enu_from_camera)) == pytest.approx(1, abs=1e-12)
        assert quaternion[3] >= 0


@pytest.mark.parametrize("system", ["EPSG:25832", "EPSG:25832+7837"])
def test_heights_above_the_geoid_are_raised_by_its_undulation(system: str) -> None:
    pose = MapPose((640_000.0, 5_320_000.0, 412.0), 30.0, -5.0, 2.0)
    found = known(geopose_of({"coordinate_system": system, "geoid_undulation_m": 46.2}, pose))
    # By PROJ: echo 640000 5320000 458.2 | cs2cs EPSG:25832 EPSG:4979
    assert list(found["position"].values()) == pytest.approx([48.017943985, 10.877474808, 458.2], abs=2e-9)
    ellipsoidal = MapPose((640_000.0, 5_320_000.0, 458.2), 30.0, -5.0, 2.0)
    assert found == geopose_of({"coordinate_system": _UTM_WITH_HEIGHTS}, ellipsoidal)


def test_a_grid_is_turned_by_its_convergence_and_heights_have_to_be_ellipsoidal() -> None:
    pose = MapPose((640_000.0, 5_320_000.0, 412.0), 90.0, 0.0, 0.0)
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
