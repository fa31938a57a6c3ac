"""The made-up room of `panoloc demo`: its files, and the poses that are known by construction."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from core.camera.camera import Camera
from core.geometry.pose import Pose, pose_error
from core.scan.ply.writer import write_ply
from lab.demo_room import CHANGED_FRACTION, JPEG_QUALITY, NUM_SCAN_POINTS, ROOM_AREA_M2, ROOM_FAMILY
from lab.rooms import Scene, SceneSpec, build_scene, change_scene, sample_pose, scan_scene, take_panorama, take_photo
from lab.rooms.capture.shooting import Shooting
from service.client import JsonObject

PANORAMA_WIDTH = 1536
PHOTO_SIZE, PHOTO_HFOV_DEG = (1600, 1200), 69.0
NUM_PHOTO_TRIES = 12


@dataclass(frozen=True)
class DemoQuery:
    """A panorama or photo with the pose that it was taken from.

    options: what the service is told of it, as of `POST /localize`. may_stay_open: shows so little that `not_localized` is no failure.
    """

    image: Path
    description: str
    pose: Pose
    options: JsonObject = field(default_factory=dict)
    may_stay_open: bool = False

    def error_of(self, answer: JsonObject) -> tuple[float | None, float | None]:
        """Return (metres, degrees) between the answer's pose and the known one; (None, None) without a pose."""
        if answer.get("pose") is None:
            return None, None
        matrix = np.asarray(answer["pose"]["map_from_camera"]["matrix"], np.float64)
        error = pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), self.pose)
        return error.position_m, error.orientation_deg


@dataclass(frozen=True)
class DemoScene:
    """The files of a made-up room."""

    scan: Path
    queries: tuple[DemoQuery, ...]

    @property
    def file_names(self) -> list[str]:
        """Return the names of the scan and the images."""
        return [self.scan.name, *(query.image.name for query in self.queries)]


def make_demo_scene(folder: Path, seed: int, say: Callable[[str], None]) -> DemoScene:
    """Build a room, scan it, photograph it as scanned and after changes, and once with a phone; write all of it with `truth.json`.

    The same seed makes the same files. `say` hears what is being made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    say("building a room")
    room = build_scene(SceneSpec(kind="room", seed=seed, family=ROOM_FAMILY, area_m2=ROOM_AREA_M2))
    say("scanning it")
    scan = folder / "scan.ply"
    write_ply(scan, scan_scene(room, num_points=NUM_SCAN_POINTS, seed=seed))
    say("moving furniture")
    changed = change_scene(room, CHANGED_FRACTION, seed=seed)
    rng = np.random.default_rng(seed)
    shots = (
        ("as-scanned", "the room as it was scanned", room),
        ("changed", f"{CHANGED_FRACTION:.0%} of the furniture moved, gone or replaced", changed),
    )
    queries = []
    for name, description, scene in shots:
        say(f"taking a panorama, {name}")
        pose = sample_pose(scene, rng, "tilted")
        file = folder / f"{name}.jpg"
        Image.fromarray(take_panorama(scene, pose, PANORAMA_WIDTH).color).save(file, quality=JPEG_QUALITY)
        queries.append(DemoQuery(file, description, pose))
    _write_truth(folder / "truth.json", scan, queries)
    say("taking a photo")
    return DemoScene(scan, (*queries, _take_photo(folder, room, rng)))


def _take_photo(folder: Path, room: Scene, rng: np.random.Generator) -> DemoQuery:
    """Take one photo as a phone does, in the direction in which most of the room is seen."""
    camera = Camera.from_hfov("pinhole", *PHOTO_SIZE, PHOTO_HFOV_DEG)
    poses = [pose for _ in range(NUM_PHOTO_TRIES) for pose in Shooting().poses(room, rng)]
    glances = [take_photo(room, camera.resized(PHOTO_SIZE[0] // 32, PHOTO_SIZE[1] // 32), pose) for pose in poses]
    best = int(np.argmax([np.median(glance.hits.distance) for glance in glances]))
    file = folder / "photo.jpg"
    Image.fromarray(take_photo(room, camera, poses[best]).photo.color).save(file, quality=JPEG_QUALITY)
    told: JsonObject = {"cameras": [{"model": "pinhole", "hfov_deg": PHOTO_HFOV_DEG}], "hints": {"upright": True}}
    return DemoQuery(
        file, f"one ordinary photo, {PHOTO_HFOV_DEG:g} degrees wide", poses[best], told, may_stay_open=True
    )


def _write_truth(file: Path, scan: Path, queries: list[DemoQuery]) -> None:
    truth = {
        "name": "demo",
        "convention": "x_map = rotation @ x_camera + position_m; camera: x forward (image centre), y left, z up",
        "scans": [scan.name],
        "queries": [
            {
                "image": query.image.name,
                "position_m": query.pose.position.tolist(),
                "rotation": query.pose.rotation.tolist(),
                "tags": [query.image.stem],
            }
            for query in queries
        ],
    }
    file.write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")
