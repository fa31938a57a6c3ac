"""A walk through a furnished room, as a phone in the hand sees it: poses, and a frame per second, for clients that track."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.lab.rooms import Scene, SceneSpec, build_scene, scan_scene, take_photo
from panoloc.lab.rooms.capture.shooting import turned
from tests.core.image.picture_files import encoded
from tests.packaging.test_js_package import node

POSES_PER_S = 30
_HFOV_DEG = 69.0
_SPEED_M_S = 0.8
_EYE_M = (1.35, 1.65)
_CLEARANCE_M = 0.35


@dataclass(frozen=True)
class Walked:
    """How a tracker did. in_place: the share of the time after its first answer in which it showed the anchor within 5 cm and 1 degree.
    median_m, median_deg: of its errors. num_queries: it asked. events: by name, with the second of each."""

    in_place: float
    median_m: float
    median_deg: float
    num_queries: int
    events: list[tuple[str, float]]


def walk_with_tracker(url: str, map_id: str, folder: Path, drift_seed: int) -> Walked:
    """Let the tracker of the npm package walk with a phone whose tracking drifts, and whose origin jumps once."""
    printed = node("tests/walk.ts", url, map_id, folder, str(drift_seed))
    (walked,) = map(json.loads, printed.splitlines())
    errors = [(error["m"], error["deg"]) if error else (np.inf, np.inf) for error in walked["errors"]]
    metres, degrees = np.array(errors).T
    in_place = float(np.mean((metres < 0.05) & (degrees < 1)))
    medians = float(np.median(metres)), float(np.median(degrees))
    return Walked(in_place, *medians, len(walked["took_s"]), [(name, at_s) for name, at_s in walked["events"]])


def write_walk(folder: Path, seed: int, seconds: int = 60, width: int = 640) -> None:
    """Write scan.ply, a JPEG of each second, `width` pixels wide, and walk.json.

    walk.json: `camera` (an entry of `cameras`), `poses_per_s` and `map_from_camera` at each step, in the axes of webxr; `frames`: the
    numbers of the steps at which the pictures were taken; `anchor`: a point of the map.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = build_scene(SceneSpec(kind="room", seed=seed, area_m2=20))
    write_ply(folder / "scan.ply", scan_scene(scene, num_points=200_000))
    poses, height = _walk(scene, np.random.default_rng(seed), seconds), width * 3 // 4
    focal_px = width / 2 / math.tan(math.radians(_HFOV_DEG) / 2)
    camera = Camera("pinhole", width, height, focal_px, focal_px, width / 2, height / 2)
    frames = list(range(0, len(poses), POSES_PER_S))
    for number in frames:
        (folder / f"{number}.jpg").write_bytes(
            encoded(take_photo(scene, camera, poses[number]).photo.color, "JPEG", quality=90)
        )
    lens = {"model": "pinhole", "width_px": width, "height_px": height, "fx_px": focal_px}
    walk = {
        "camera": lens,
        "poses_per_s": POSES_PER_S,
        "frames": frames,
        "map_from_camera": [_as_sent(pose.in_frame("webxr")) for pose in poses],
        "anchor": _anchor(scene),
    }
    (folder / "walk.json").write_text(json.dumps(walk))


def _walk(scene: Scene, rng: np.random.Generator, seconds: int) -> list[Pose]:
    """Return the pose of the camera at each step: straight from place to place, looking around meanwhile."""
    time_s = np.arange(seconds * POSES_PER_S) / POSES_PER_S
    phase = rng.uniform(0, 2 * np.pi, 3)
    yaw = phase[0] + 0.25 * time_s + 0.9 * np.sin(0.35 * time_s + phase[1])
    pitch = math.radians(6) + math.radians(7) * np.sin(0.5 * time_s + phase[2])
    roll = math.radians(2) * np.sin(0.8 * time_s)
    positions = _way(scene, rng, len(time_s))
    return [Pose(turned(*angles), place) for *angles, place in zip(yaw, pitch, roll, positions, strict=True)]


def _way(scene: Scene, rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    room = scene.rooms[0]

    def draw() -> NDArray[np.float64]:
        return rng.uniform((room.x0, room.y0, _EYE_M[0]), (room.x1, room.y1, _EYE_M[1]), 3)

    def is_clear(start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        between = start + np.linspace(0, 1, 20)[:, None] * (end - start)
        return bool((scene.surface.clearance(between) > _CLEARANCE_M).all())

    here = draw()
    while not is_clear(here, here):
        here = draw()
    steps: list[NDArray[np.float64]] = []
    while len(steps) < count:
        there = draw()
        length_m = float(np.linalg.norm(there - here))
        if length_m < 0.8 or not is_clear(here, there):
            continue
        shares = np.linspace(0, 1, max(2, round(length_m / _SPEED_M_S * POSES_PER_S)), endpoint=False)
        eased = shares * shares * (3 - 2 * shares)  # slow at both ends
        steps += list(here + eased[:, None] * (there - here))
        here = there
    return np.array(steps[:count])


def _anchor(scene: Scene) -> dict[str, float]:
    """Return the middle of the room a metre above its floor: (x, z, −y) in a map with y up."""
    room = scene.rooms[0]
    return {"x": (room.x0 + room.x1) / 2, "y": 1.0, "z": -(room.y0 + room.y1) / 2}


def _as_sent(pose: Pose) -> dict[str, dict[str, float]]:
    return {
        "position_m": dict(zip("xyz", pose.position.tolist(), strict=True)),
        "quaternion": dict(zip("xyzw", pose.quaternion_xyzw.tolist(), strict=True)),
    }
