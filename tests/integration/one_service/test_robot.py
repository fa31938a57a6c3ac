"""A robot drives through the small room: DDS between it and `panoloc ros2`, HTTP from there to the service, each a process."""

from pathlib import Path

import numpy as np
import pytest

from tests.integration.running_service import RunningService
from tests.integration.small_room import room_scene
from tests.ros2.drive import Faults, drive
from tests.ros2.running_node import environment, errors, errors_of_odometry, played, running_node

pytestmark = pytest.mark.integration


def test_a_robot_gets_its_first_pose_and_stays_right_where_its_odometry_does_not(
    service: RunningService, map_id: str, tmp_path: Path
) -> None:
    faults = Faults(scale=1.1, heading_rad_per_m=0.05)
    driven = drive(room_scene(), seconds=14.0, image_every_s=0.6, faults=faults, width=320)
    variables, log = environment(), tmp_path / "node.log"
    # A drift of 0.2 allows the heading 0.04 rad per metre, about the fault; with half of that the covariance is too small.
    with running_node(str(service.http.base_url), map_id, log, variables, "--odometry-drift", "0.2"):
        heard = played(driven, tmp_path, variables, speed=1.0)
    metres, degrees = errors(driven, heard)
    _, alone_deg = errors_of_odometry(driven)
    known = ~np.isnan(metres)
    assert known.any(), log.read_text()
    # In a room of 12 m² odometry alone loses the heading; its position stays as near as photos of 320 pixels tell it.
    assert np.median(metres[known]) < 0.15, log.read_text()
    assert np.median(degrees[known]) < 4 < 8 < alone_deg.max(), log.read_text()
    # The covariance that goes with it is honest.
    std_m = np.array(heard["std_m"])
    assert np.mean(metres[known] < 3 * std_m[known] + 0.02) > 0.9
    assert heard["initial"]
