"""How far a found pose may be from the true one."""

from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.results import Localization


def assert_found(found: Localization, pose: Pose, position_m: float = 0.05, orientation_deg: float = 5.0) -> None:
    assert found.best is not None
    error = pose_error(found.best.pose, pose)
    assert error.within(position_m, orientation_deg), f"{error}, {found.status}"
