"""Frames worth sending: each shows another direction or place than the others."""

from dataclasses import dataclass
from typing import Any

from .estimate import ANOTHER_VIEW, Travel
from .poses import Pose, distance_between

MAX_FRAMES = 6
_WINDOW_M = 4.0  # of driving; over more the odometry has drifted too far for one session


@dataclass(frozen=True)
class Frame:
    """An image with its entry of `cameras`, where it was taken, and how far the robot had come by then."""

    stamp: float
    image: Any
    camera: dict[str, Any]
    odom_from_camera: Pose
    travel: Travel


class Frames:
    """The frames of the next query, the newest first."""

    def __init__(self) -> None:
        self._reference: list[Frame] = []  # seen, and not sent again
        self.kept: list[Frame] = []

    def is_new(self, odom_from_camera: Pose) -> bool:
        """Tell whether an image there shows more than those that are kept."""
        return not self._alike(odom_from_camera)

    def add(self, frame: Frame) -> None:
        """Keep a frame, in place of older ones that show the same, and forget those of long ago."""
        gone = {id(each) for each in self._alike(frame.odom_from_camera)}
        self.kept = [
            frame,
            *(
                each
                for each in self.kept
                if id(each) not in gone and frame.travel.since(each.travel).distance_m < _WINDOW_M
            ),
        ][:MAX_FRAMES]

    def start_anew(self) -> None:
        """Send none of these again: what comes next has to show something else, by itself."""
        self._reference, self.kept = self.kept[:1] or self._reference, []

    def _alike(self, odom_from_camera: Pose) -> list[Frame]:
        def is_alike(other: Frame) -> bool:
            moved_m, turned_rad = distance_between(other.odom_from_camera, odom_from_camera)
            return not Travel(moved_m, turned_rad).shows_more_than(ANOTHER_VIEW)

        return [each for each in (*self.kept, *self._reference) if is_alike(each)]
