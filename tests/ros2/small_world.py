"""A robot and a service in one process: messages as ROS has them, and answers that a test decides."""

import math
from concurrent.futures import Future
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from panoloc.ros2.estimate import Spread
from panoloc.ros2.parameters import Parameters
from panoloc.ros2.place_finder import PlaceFinder
from panoloc.ros2.poses import Pose, as_json, turned
from panoloc.ros2.service import NoAnswerError, Query

STEP_S = 0.05
OPTICAL = Pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.1, 0.0, 0.9]))
# Where the robot began: odom in the map, whose floor lies at a height of 0.3 m.
TRUTH = Pose(turned((0.0, 0.0, 1.0)), np.array([3.0, -2.0, 0.3]))


def planar(x: float, y: float, yaw: float) -> Pose:
    return Pose(turned((0.0, 0.0, yaw)), np.array([x, y, 0.0]))


def stamp_of(seconds: float) -> SimpleNamespace:
    nanoseconds = round(seconds * 1e9)
    return SimpleNamespace(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def transform(seconds: float, parent: str, child: str, pose: Pose) -> SimpleNamespace:
    position, quaternion = dict(zip("xyz", pose.position, strict=True)), dict(zip("xyzw", pose.xyzw, strict=True))
    moved = SimpleNamespace(translation=SimpleNamespace(**position), rotation=SimpleNamespace(**quaternion))
    header = SimpleNamespace(stamp=stamp_of(seconds), frame_id=parent)
    return SimpleNamespace(transforms=[SimpleNamespace(header=header, child_frame_id=child, transform=moved)])


def camera_info() -> SimpleNamespace:
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    k = [400.0, 0, 319.5, 0, 400.0, 239.5, 0, 0, 1]
    lens = SimpleNamespace(width=640, height=480, k=k, d=[0.0] * 5, p=[0.0] * 12, distortion_model="plumb_bob")
    return SimpleNamespace(**vars(lens), binning_x=0, binning_y=0, roi=roi)


def answer(map_from_odom: Pose, position_m: float = 0.03, confidence: float = 0.99, **others: Any) -> dict[str, Any]:
    """Return an answer of the service. position_m: its radius."""
    accuracy = {"position_m": position_m, "orientation_deg": 0.5}
    found = {"status": "localized", "confidence": confidence, "accuracy": accuracy, "warnings": [], "reasons": []}
    return {**found, "map_from_session": as_json(map_from_odom), **others}


@dataclass
class World:
    """A robot with a place finder. replies: what the service says next, the last one again and again: an answer or an error."""

    parameters: Parameters = field(default_factory=lambda: Parameters(map="map_a"))
    replies: list[Any] = field(default_factory=lambda: [answer(TRUTH)])

    def __post_init__(self) -> None:
        self.queries: list[Query] = []
        self.transforms: list[tuple[float, Pose]] = []
        self.poses: list[tuple[float, Pose, Spread]] = []
        self.initial: list[tuple[float, Pose]] = []
        self.infos: list[str] = []
        self.warnings: list[str] = []
        self.odom_from_base, self.time = planar(0, 0, 0), 100.0
        self.finder = PlaceFinder(self.parameters, self, self._ask)
        self.finder.on_camera_info(camera_info())
        self.finder.on_tf(transform(0, "base_link", "optical", OPTICAL), is_static=True)

    def _ask(self, query: Query) -> "Future[dict[str, Any]]":
        self.queries.append(query)
        future: Future[dict[str, Any]] = Future()
        reply = self.replies.pop(0) if len(self.replies) > 1 else self.replies[0]
        if isinstance(reply, NoAnswerError):
            future.set_exception(reply)
        else:
            future.set_result(reply)
        return future

    def drive(self, metres: float = 0.0, turn_deg: float = 0.0, seconds: float = 2.0, images: bool = True) -> None:
        """Move evenly, with an image at every step."""
        steps = round(seconds / STEP_S)
        for _ in range(steps):
            self.time += STEP_S
            step = planar(metres / steps, 0.0, math.radians(turn_deg) / steps)
            self.odom_from_base = self.odom_from_base @ step
            if images:
                header = SimpleNamespace(stamp=stamp_of(self.time - 0.02), frame_id="optical")
                self.finder.on_image(SimpleNamespace(header=header, format="jpeg", data=b"\xff\xd8\xff\xe0"))
            self.finder.on_tf(transform(self.time, "odom", "base_link", self.odom_from_base))

    @property
    def map_from_odom(self) -> Pose:
        return self.transforms[-1][1]

    def send_transform(self, stamp: float, map_from_odom: Pose) -> None:
        self.transforms.append((stamp, map_from_odom))

    def send_pose(self, stamp: float, map_from_base: Pose, spread: Spread, is_initial: bool) -> None:
        if is_initial:
            self.initial.append((stamp, map_from_base))
        else:
            self.poses.append((stamp, map_from_base, spread))

    def info(self, text: str) -> None:
        self.infos.append(text)

    def warning(self, text: str) -> None:
        self.warnings.append(text)
