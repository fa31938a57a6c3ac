"""`python -m tests.campaign.changed_house FOLDER`: how well changed pixels of a case with several states of furniture are told, per room.

FOLDER: the case `house`. What changed is known from its panoramas: those of one room have the same pose and light, so pixels differ where
furniture does. Faint differences count neither way. Poses are the true ones.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from panoloc.core.camera.rig import Panorama
from panoloc.core.changes.evidence import photo_evidence
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions, project
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.core.scan.reading import read_scan
from tests.campaign.changes import area_under_curve

_SCANS = {"furnished": "full", "empty": "empty"}  # and the state of the panoramas that shows the same
_SAME, _OTHER = 6, 12  # largest difference of a channel, 0..255, below and above which a pixel is the same, or changed


def main(arguments: Sequence[str]) -> int:
    """Print the area under the curve of each scan and photo of another state of furniture."""
    folder = Path(arguments[0])
    queries = {each["image"]: each for each in json.loads((folder / "truth.json").read_text())["queries"]}
    rooms = [name.removesuffix("_full.jpg") for name in queries if name.endswith("_full.jpg")]
    print("| scan | photo | changed | pixel AUC |\n|---|---|---|---|")
    for scanned, same in _SCANS.items():
        cloud = read_scan(folder / f"scan_{scanned}.ply")
        points, colors = torch.from_numpy(cloud.positions), torch.from_numpy(cloud.colors).float() / 255
        rendered = make_render_cloud(points, colors, point_spacing(points))
        for room in rooms:
            for state in sorted({"full", "simple", "empty"} - {same}):
                query = queries[f"{room}_{state}.jpg"]
                photo, before = (_pixels(folder / f"{room}_{name}.jpg") for name in (state, same))
                pose = Pose(np.array(query["rotation"]), np.array(query["position_m"]) - cloud.origin_offset)
                seen = photo_evidence(rendered, Panorama(photo, np.ones(photo.shape[:2], np.bool_)), pose)
                apart = _turned(np.abs(photo.astype(np.int16) - before).max(2), pose, len(seen.changed))
                counts = seen.known.numpy() & ((apart < _SAME) | (apart > _OTHER))
                changed = apart[counts] > _OTHER
                area = area_under_curve(seen.changed.numpy()[counts], changed)
                print(f"| {scanned} | {room}, {state} | {changed.mean():.1%} | {area:.3f} |")
    return 0


def _pixels(file: Path) -> NDArray[np.uint8]:
    return np.array(Image.open(file).convert("RGB"))


def _turned(image: NDArray[np.int16], pose: Pose, rows: int) -> NDArray[np.float32]:
    """Return an image (H, 2H) on the sphere of (rows, 2 rows) pixels in the axes of the map."""
    height = len(image)
    small = torch.nn.functional.avg_pool2d(torch.from_numpy(image).float()[None, None], height // rows)[0, 0].numpy()
    axes = torch.from_numpy(pose.rotation).float()
    u, v = project(pixel_directions(rows, 2 * rows) @ axes, *small.shape)
    return np.asarray(
        small[v.long().clamp(0, len(small) - 1).numpy(), u.long().clamp(0, small.shape[1] - 1).numpy()], np.float32
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
