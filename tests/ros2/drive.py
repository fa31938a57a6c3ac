"""A robot that drives through a procedural flat: where it is, where its wheels say it is, and what its camera sees."""

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.lab.rooms import Scene, SceneSpec, build_scene, scan_scene, take_photo
from panoloc.lab.rooms.capture.camera_look import PHOTO, photo_with_look
from panoloc.ros2.poses import Pose as Motion
from panoloc.ros2.poses import turned

Array = NDArray[np.float64]

STEP_S = 0.04
_SPEED_MPS, _TURN_RADPS = 0.5, math.radians(45.0)
_CELL_M, _CLEAR_M = 0.1, 0.22
# The optical frame (right, down, forward) on the robot, and its body frame (forward, left, up) in the optical one.
BASE_FROM_OPTICAL = Motion(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.array([0.15, 0.0, 0.9]))


@dataclass(frozen=True)
class Faults:
    """Of the odometry: a scale, heading by the way driven, ways that the wheels do not count from a time on, and where it is carried."""

    scale: float = 1.03
    heading_rad_per_m: float = math.radians(0.6)
    slip: tuple[float, float] | None = None  # at a time, by metres
    carried: tuple[float, float] | None = None  # at a time, as far as it would drive in so many seconds


@dataclass(frozen=True)
class Drive:
    """By steps of STEP_S: map_from_base and odom_from_base (N, 3) as x, y, yaw. images: PNG by the number of their step."""

    truth: Array
    odometry: Array
    camera: Camera
    images: dict[int, NDArray[Any]]


def motion(planar: Array) -> Motion:
    """Return x, y, yaw as a motion."""
    x, y, yaw = planar.tolist()
    return Motion(turned((0.0, 0.0, yaw)), np.array([x, y, 0.0]))


def flat(seed: int) -> Scene:
    """Build the flat."""
    return build_scene(SceneSpec(kind="flat", seed=seed))


def scan_of(scene: Scene) -> bytes:
    """Return the scan as PLY."""
    return encode_ply(scan_scene(scene, num_points=300_000))


def drive(scene: Scene, seconds: float, image_every_s: float, faults: Faults, width: int = 480) -> Drive:
    """Drive from room to room."""

    def photo(camera: Camera, body: Pose, number: int) -> NDArray[Any]:
        """Return what the camera sees, with noise and the like."""
        return np.asarray(photo_with_look(take_photo(scene, camera, body).photo, PHOTO, (7, number)).color)

    return drive_along(_route(scene), photo, seconds, image_every_s, faults, width)


def drive_along(
    route: Array,
    photo: Callable[[Camera, Pose, int], NDArray[Any]],
    seconds: float,
    image_every_s: float,
    faults: Faults,
    width: int = 480,
) -> Drive:
    """Drive along a polyline (N, 2), there and back. photo: takes the picture of a step (h, w, 3) at a pose of the camera."""
    truth = _along(route, seconds + (faults.carried[1] if faults.carried else 0.0) + 10.0)
    steps = _steps(round(seconds / STEP_S), faults)
    truth = truth[steps]
    odometry = _odometry(truth, steps, faults)
    camera = Camera("pinhole", width, width * 3 // 4, width / 2, width / 2, width / 2, width * 3 / 8)  # 90 degrees
    every = round(image_every_s / STEP_S)
    images = {number: photo(camera, _body(truth[number]), number) for number in range(0, len(truth), every)}
    return Drive(truth, odometry, camera, images)


def _steps(num: int, faults: Faults) -> NDArray[np.int64]:
    """Return for each step how far on the way the robot is: it slips or is carried on at some."""
    steps = np.arange(num)
    for fault, metres in ((faults.slip, _SPEED_MPS), (faults.carried, 1.0)):
        if fault is not None:
            at, by = fault
            steps = steps + np.where(np.arange(num) >= at / STEP_S, round(by / metres / STEP_S), 0)
    return steps


def _odometry(truth: Array, steps: NDArray[np.int64], faults: Faults) -> Array:
    poses = [np.zeros(3)]
    for number in range(1, len(truth)):
        before, after = motion(truth[number - 1]), motion(truth[number])
        step = before.inverse() @ after
        x, y, yaw = poses[-1]
        if steps[number] - steps[number - 1] == 1:
            moved = float(step.position[0]) * faults.scale
            yaw += math.atan2(step.rotation[1, 0], step.rotation[0, 0]) + abs(moved) * faults.heading_rad_per_m
            x, y = x + moved * math.cos(yaw), y + moved * math.sin(yaw)
        poses.append(np.array([x, y, yaw]))
    return np.array(poses)


def _body(truth: Array) -> Pose:
    """Return the pose of the camera, looking along x."""
    place = motion(truth) @ BASE_FROM_OPTICAL
    return Pose(place.rotation @ BASE_FROM_OPTICAL.rotation.T, place.position)


def _along(route: Array, seconds: float) -> Array:
    """Return poses (N, 3) along a polyline, there and back: it turns where it stands, then drives straight."""
    poses: list[tuple[float, float, float]] = []
    x, y = route[0]
    yaw = math.atan2(*(route[1] - route[0])[::-1])
    corners = [*route[1:], *route[-2::-1]] * 20
    for corner in corners:
        way = math.hypot(corner[0] - x, corner[1] - y)
        wanted = math.atan2(corner[1] - y, corner[0] - x)
        turn = (wanted - yaw + math.pi) % (2 * math.pi) - math.pi
        num_turns = math.ceil(abs(turn) / _TURN_RADPS / STEP_S)
        poses += [(x, y, yaw + turn * each / num_turns) for each in range(1, num_turns + 1)]
        yaw = wanted
        num = math.ceil(way / _SPEED_MPS / STEP_S)
        poses += [
            (x + (corner[0] - x) * each / num, y + (corner[1] - y) * each / num, yaw) for each in range(1, num + 1)
        ]
        x, y = corner
        if len(poses) * STEP_S > seconds:
            break
    return np.array(poses)


def _route(scene: Scene) -> Array:
    """Return corners of a way through the free space, by the clearest place of every room or every quarter that can be reached."""
    low = np.min([(room.x0, room.y0) for room in scene.rooms], axis=0)
    high = np.max([(room.x0 + room.size_m[0], room.y0 + room.size_m[1]) for room in scene.rooms], axis=0)
    num = np.ceil((high - low) / _CELL_M).astype(int)
    cells = np.stack(np.meshgrid(*map(np.arange, num), indexing="ij"), -1)
    places = low + (cells + 0.5) * _CELL_M
    flat_places = places.reshape(-1, 2)
    clear = np.min(
        [
            scene.surface.clearance(np.column_stack((flat_places, np.full(len(flat_places), z))))
            for z in (0.35, 0.9, 1.3)
        ],
        0,
    ).reshape(num)
    goals = []
    for corner, size in _areas(scene):
        inside = ((places > corner) & (places < corner + size)).all(-1)
        goals.append(tuple(int(each) for each in np.unravel_index(np.argmax(np.where(inside, clear, -1)), num)))
    way = [goals[0]]
    for goal in goals[1:]:
        way += _shortest(clear, way[-1], goal)[1:]
    return _corners(places, clear, way)


def _areas(scene: Scene) -> list[tuple[Array, Array]]:
    """Return corner and size of each room, or of the quarters of the only one."""
    areas = [(np.array((room.x0, room.y0)), np.array(room.size_m[:2])) for room in scene.rooms]
    if len(areas) > 1:
        return areas
    ((corner, size),) = areas
    return [(corner + size / 2 * quarter, size / 2) for quarter in ((0, 0), (1, 0), (1, 1), (0, 1))]


Cell = tuple[int, ...]


def _shortest(clear: NDArray[np.float32], start: Cell, goal: Cell) -> list[Cell]:
    """Return the cells of a way, or the start alone where there is none."""
    queue: list[tuple[float, Cell]] = [(0.0, start)]
    cost, before = {start: 0.0}, {start: start}
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == goal:
            break
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            other = cell[0] + dx, cell[1] + dy
            if not (0 <= other[0] < clear.shape[0] and 0 <= other[1] < clear.shape[1]) or clear[other] < _CLEAR_M:
                continue
            reached = cost[cell] + math.hypot(dx, dy) / min(float(clear[other]), 0.6)
            if reached < cost.get(other, math.inf):
                cost[other], before[other] = reached, cell
                heapq.heappush(queue, (reached, other))
    if goal not in before:
        return [start]
    way = [goal]
    while way[-1] != start:
        way.append(before[way[-1]])
    return way[::-1]


def _corners(places: Array, clear: NDArray[np.float32], way: list[Cell]) -> Array:
    """Return the way with the fewest corners: straight on while the line is clear, three metres at most."""
    corners, at = [way[0]], 0
    while at < len(way) - 1:
        on = at + 1
        for far in range(at + 2, min(at + 30, len(way))):
            line = np.linspace(way[at], way[far], 60).round().astype(int)
            if clear[line[:, 0], line[:, 1]].min() >= _CLEAR_M:
                on = far
        corners.append(way[on])
        at = on
    return np.array([places[each] for each in corners])
