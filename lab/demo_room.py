"""The procedural room that anybody can try: its scan, and images whose poses are known by construction.

    python -m panoloc.lab.demo_room FOLDER    writes room.ply and panorama.jpg of the changed room, the same ones each time

The service runs this as a process of its own when its console asks for the demo room; it does not import it.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.scan.ply.writer import write_ply
from panoloc.lab.rooms import (
    PosedPanorama,
    Scene,
    SceneSpec,
    build_scene,
    change_scene,
    sample_pose,
    scan_scene,
    take_panorama,
    take_photo,
    write_case_folder,
)
from panoloc.lab.rooms.capture.shooting import Shooting
from panoloc.service.client import JsonObject

SEED = 4
NUM_SCAN_POINTS = 400_000
CHANGED_FRACTION = 0.6
JPEG_QUALITY = 92
PANORAMA_WIDTH = 1536
_PHOTO_SIZE, _PHOTO_HFOV_DEG = (1600, 1200), 69.0
_NUM_PHOTO_TRIES = 12


def demo_scene(seed: int = SEED) -> Scene:
    """Return the room; another seed makes another one."""
    return build_scene(SceneSpec(kind="room", seed=seed, family="nordic", area_m2=24.0))


def make_demo_room(folder: Path) -> None:
    """Write the scan and the panorama."""
    room = demo_scene()
    write_ply(folder / "room.ply", scan_scene(room, num_points=NUM_SCAN_POINTS, seed=SEED))
    changed = change_scene(room, CHANGED_FRACTION, seed=SEED)
    pose = sample_pose(changed, np.random.default_rng(SEED), "tilted")
    picture = take_panorama(changed, pose, PANORAMA_WIDTH).color
    Image.fromarray(picture).save(folder / "panorama.jpg", quality=JPEG_QUALITY)


@dataclass(frozen=True)
class DemoQuery:
    """A panorama or photo with the pose that it was taken from.

    options: of the query, as in `POST /localize`. may_stay_open: shows so little that `not_localized` is no failure.
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
    """The files of a procedural room."""

    scan: Path
    queries: tuple[DemoQuery, ...]


def make_demo_scene(folder: Path, seed: int, say: Callable[[str], None]) -> DemoScene:
    """Build a room, scan it, photograph it as scanned and after changes, and once with a phone; write all of it with `truth.json`.

    The same seed makes the same files. `say` receives what is being made.
    """
    say("building a room")
    room = demo_scene(seed)
    say("scanning it")
    cloud = scan_scene(room, num_points=NUM_SCAN_POINTS, seed=seed)
    say("moving furniture")
    changed = change_scene(room, CHANGED_FRACTION, seed=seed)
    rng = np.random.default_rng(seed)
    shots = {
        "as-scanned": ("the room as it was scanned", room),
        "changed": (f"{CHANGED_FRACTION:.0%} of the furniture moved, gone or replaced", changed),
    }
    panoramas = []
    for name, (_, scene) in shots.items():
        say(f"taking a panorama, {name}")
        pose = sample_pose(scene, rng, "tilted")
        panoramas.append(PosedPanorama(name, take_panorama(scene, pose, PANORAMA_WIDTH), pose, (name,)))
    write_case_folder(folder, "demo", cloud, panoramas)
    say("taking a photo")
    photo = _take_photo(folder, room, rng)
    queries = [DemoQuery(folder / f"{one.name}.jpg", shots[one.name][0], one.pose) for one in panoramas]
    return DemoScene(folder / "scan.ply", (*queries, photo))


def _take_photo(folder: Path, room: Scene, rng: np.random.Generator) -> DemoQuery:
    """Take one photo as a phone does, in the direction in which most of the room is seen."""
    camera = Camera.from_hfov("pinhole", *_PHOTO_SIZE, _PHOTO_HFOV_DEG)
    poses = [pose for _ in range(_NUM_PHOTO_TRIES) for pose in Shooting().poses(room, rng)]
    glances = [take_photo(room, camera.resized(_PHOTO_SIZE[0] // 32, _PHOTO_SIZE[1] // 32), pose) for pose in poses]
    best = int(np.argmax([np.median(glance.hits.distance) for glance in glances]))
    file = folder / "photo.jpg"
    Image.fromarray(take_photo(room, camera, poses[best]).photo.color).save(file, quality=JPEG_QUALITY)
    options: JsonObject = {"cameras": [{"model": "pinhole", "hfov_deg": _PHOTO_HFOV_DEG}], "hints": {"upright": True}}
    description = f"one ordinary photo, {_PHOTO_HFOV_DEG:g} degrees wide"
    return DemoQuery(file, description, poses[best], options, may_stay_open=True)


if __name__ == "__main__":
    make_demo_room(Path(sys.argv[1]))
