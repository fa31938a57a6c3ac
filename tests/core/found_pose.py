"""What a test expects of an answer: that something is there, and that a found pose is near the true one."""

from typing import TypeVar

from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.results import Candidate, Localization

T = TypeVar("T")


def known(value: T | None) -> T:
    assert value is not None
    return value


def best_of(found: Localization) -> Candidate:
    return known(found.best)


def assert_found(found: Localization, pose: Pose, position_m: float = 0.05, orientation_deg: float = 5.0) -> None:
    error = pose_error(best_of(found).pose, pose)
    assert error.within(position_m, orientation_deg), f"{error}, {found.status}"
