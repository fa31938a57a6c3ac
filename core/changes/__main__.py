"""`python -m panoloc.core.changes QUESTION.json TARGET.zip`: what changed since a scan, with a picture of each change.

QUESTION.json: {"points": "points.ply", "photos": [{"image": "photo.webp", "position_m": [x, y, z], "quaternion_xyzw": [x, y, z, w],
"time": "2026-11-21T12:00:00Z"}]}; images are panoramas on the sphere, transparent where they show nothing. One that has `frame`, of its
pose, `camera` (null, or the description by its caller) and `found_camera` (as in an answer) is an image as uploaded. The zip has
`objects.json`, as in the HTTP contract, and `ID.jpg` of each: the photo and the scan from the same place; of what moved, the new place
above the old one.
"""

import json
import sys
import zipfile
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.crops import crop_pair, encode_jpeg
from panoloc.core.changes.finding import Change, DatedPhoto, find_changes, in_cloud
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.photo_window import rig_on_sphere
from panoloc.core.image.reader import read_image
from panoloc.core.render.render_cloud import RenderCloud, make_render_cloud, point_spacing
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_points_of_map

_PHOTO_ROWS = 512  # of an image on the sphere, as of the small photos that answers keep


def main(arguments: Sequence[str]) -> int:
    """Answer one question and return the exit code."""
    question = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    cloud = read_points_of_map(Path(question["points"]))
    photos = [photo_of(each) for each in question["photos"]]
    found = find_changes(cloud, photos)
    points, colors = torch.from_numpy(cloud.positions), torch.from_numpy(cloud.colors).float() / 255
    rendered = make_render_cloud(points, colors, point_spacing(points))
    with zipfile.ZipFile(arguments[1], "w") as archive:
        archive.writestr("objects.json", json.dumps([object_document(each, photos) for each in found]))
        for each in found:
            archive.writestr(f"{each.id}.jpg", encode_jpeg(_picture(each, photos, rendered, cloud)))
    return 0


def object_document(change: Change, photos: Sequence[DatedPhoto]) -> dict[str, Any]:
    """Return a change as in the HTTP contract, but for its picture and its floor."""
    times = [photos[number].time for number in change.photos]
    return {
        "id": change.id,
        "kind": change.kind,
        "center_m": _rounded(change.center),
        "size_m": _rounded(change.size),
        "from_m": None if change.from_center is None else _rounded(change.from_center),
        "seen_from_m": _rounded(photos[change.photos[0]].pose.position),
        "certainty": round(change.certainty, 3),
        "is_sure": change.certainty >= CHANGES.sure,
        "num_photos": len(times),
        "first_seen_at": min(times).isoformat().replace("+00:00", "Z"),
        "last_seen_at": max(times).isoformat().replace("+00:00", "Z"),
    }


def _rounded(vector: np.ndarray[Any, Any]) -> list[float]:
    return [round(float(value), 3) for value in vector]


def photo_of(given: dict[str, Any]) -> DatedPhoto:
    """Return a photo of a question. Raises PanoramaError and OSError."""
    pose = Pose.from_frame(given["position_m"], given["quaternion_xyzw"], given.get("frame", "ros"))
    panorama = _uploaded(given) if "found_camera" in given else _on_sphere(Path(given["image"]))
    return DatedPhoto(panorama, pose, datetime.fromisoformat(given["time"]))


def _on_sphere(image: Path) -> Panorama:
    with Image.open(image) as opened:
        pixels = np.array(opened.convert("RGBA"))
    return Panorama(pixels[..., :3].copy(), pixels[..., 3] > 127)


def _uploaded(given: dict[str, Any]) -> Panorama:
    """Return an image as uploaded on the sphere, seen by the camera that its answer was found with."""
    found, camera = given["found_camera"], given["camera"]
    if found["model"] != "equirectangular" and (camera is None or camera.get("hfov_range_deg")):
        camera = {"model": found["model"], "hfov_deg": found["hfov_deg"]}
    description = None if camera is None else CameraDescription(**camera)
    # Its size was checked when it was localized.
    photo = read_image(Path(given["image"]).read_bytes(), camera=description, max_pixels=sys.maxsize)
    sphere = rig_on_sphere(Rig.of_photo(photo), _PHOTO_ROWS)
    return Panorama(sphere.color.copy(), sphere.valid)


def _picture(change: Change, photos: Sequence[DatedPhoto], rendered: RenderCloud, cloud: PointCloud) -> Image.Image:
    """Return the crops of a change; of what moved, of the new place and below it of the old one."""
    best = photos[change.photos[0]]
    pose, half = in_cloud(best.pose, cloud), change.size / 2
    rows = [
        crop_pair(
            rendered, best.panorama, pose, center - cloud.origin_offset - half, center - cloud.origin_offset + half
        )
        for center in (change.center, change.from_center)
        if center is not None
    ]
    together = Image.new("RGB", (rows[0].width, sum(row.height for row in rows) + 4 * (len(rows) - 1)), "white")
    for number, row in enumerate(rows):
        together.paste(row, (0, number * (row.height + 4)))
    return together


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
