"""The procedural room that anybody can try: its scan, and a panorama taken after furniture was moved.

    python -m panoloc.lab.demo_room FOLDER    writes room.ply and panorama.jpg, the same ones each time

The service runs this as a process of its own when its console asks for the demo room; it does not import it.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from panoloc.core.scan.ply.writer import write_ply
from panoloc.lab.rooms import Scene, SceneSpec, build_scene, change_scene, sample_pose, scan_scene, take_panorama

SEED = 4
NUM_SCAN_POINTS = 400_000
CHANGED_FRACTION = 0.6
JPEG_QUALITY = 92
PANORAMA_WIDTH = 1536


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


if __name__ == "__main__":
    make_demo_room(Path(sys.argv[1]))
