"""A minute's walk through a furnished room, as a phone in the hand sees it: poses, and a frame per second, for clients that track."""

import json
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.lab.rooms import Scene, SceneSpec, build_scene, scan_scene, take_photo
from panoloc.lab.rooms.capture.shooting import turned
from tests.core.image.picture_files import encoded

DURATION_S, POSES_PER_S = 60, 30
_WIDTH, _HEIGHT, _HFOV_DEG = 480, 360, 69.0
_SPEED_M_S = 0.8
_EYE_M = (1.35, 1.65)
_CLEARANCE_M = 0.35


def write_walk(folder: Path, seed: int, area_m2: float = 20.0) -> None:
    """Write scan.ply, a JPEG of each second and walk.json.

    walk.json: `camera` (an entry of `cameras`), `poses_per_s` and `map_from_camera` at each step, in the axes of webxr; `frames`: the
    numbers of the steps at which the pictures were taken; `anchor`: a point of the map.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = build_scene(SceneSpec(kind="room", seed=seed, area_m2=area_m2))
    write_ply(folder / "scan.ply", scan_scene(scene, num_points=200_000))
    poses = _walk(scene, np.random.default_rng(seed))
    focal_px = _WIDTH / 2 / math.tan(math.radians(_HFOV_DEG) / 2)
    camera = Camera("pinhole", _WIDTH, _HEIGHT, focal_px, focal_px, _WIDTH / 2, _HEIGHT / 2)
    frames = list(range(0, len(poses), POSES_PER_S))
    for number in frames:
        (folder / f"{number}.jpg").write_bytes(
            encoded(take_photo(scene, camera, poses[number]).photo.color, "JPEG", quality=90)
        )
    lens = {"model": "pinhole", "width_px": _WIDTH, "height_px": _HEIGHT, "fx_px": focal_px}
    walk = {
        "camera": lens,
        "poses_per_s": POSES_PER_S,
        "frames": frames,
        "map_from_camera": [_as_sent(pose.in_frame("webxr")) for pose in poses],
        "anchor": _anchor(scene),
    }
    (folder / "walk.json").write_text(json.dumps(walk))


def _walk(scene: Scene, rng: np.random.Generator) -> list[Pose]:
    """Return the pose of the camera at each step: straight from place to place, looking around meanwhile."""
    time_s = np.arange(DURATION_S * POSES_PER_S) / POSES_PER_S
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
