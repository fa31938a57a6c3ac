"""A scan in UTM against a running service: registered, and a photo is found in it.

Scans of other kinds are registered and searched without a service in `tests/core/scan/test_photos_in_every_kind.py`.
"""

import numpy as np
import pytest
from pyproj import CRS, Proj, Transformer

from tests.core.built_maps import BOX, POSE
from tests.core.image.picture_files import encoded
from tests.core.scan.test_coordinate_systems import PLACE, UTM_32, las_at
from tests.integration.running_service import RunningService
from tests.integration.small_room import OPTIONS

pytestmark = pytest.mark.integration


def test_a_scan_in_utm_gives_headings_from_true_north(service: RunningService) -> None:
    map_id = service.register(las_at(BOX.scan(), CRS(UTM_32).to_wkt()), OPTIONS, "room.laz")
    assert service.map(map_id)["coordinate_system"] == UTM_32
    panorama = encoded(BOX.panorama(POSE).color, "JPEG", quality=95)
    answer = service.localize(panorama, map_id).json()
    pose = answer["pose"]
    position = pose["map_from_camera"]["position_m"]
    np.testing.assert_allclose([position[axis] for axis in "xyz"], POSE.position + PLACE, atol=0.05)
    longitude, latitude = Transformer.from_crs(UTM_32, 4326, always_xy=True).transform(position["x"], position["y"])
    convergence = Proj(25832).get_factors(longitude, latitude).meridian_convergence
    assert pose["north"] == "true"
    assert pose["heading_deg"] == pytest.approx((90 - pose["yaw_deg"] + convergence) % 360, abs=0.01)
    assert pose["heading_deg"] == pytest.approx((90 - 130 + convergence) % 360, abs=0.2)
