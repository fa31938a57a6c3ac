"""Queries of several cameras from the same places in furnished rooms, ready to be sent: a panorama, a photo, six frames."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from core.geometry.pose import Pose
from core.panorama.panorama import Panorama
from core.scan.ply.writer import write_ply
from lab.benchmark.timing import Say
from lab.rooms import Case, suite_cases
from service.client import JsonObject, PanolocClient

_SUITE = "changed"  # furniture moves between the scan and the photo, as it does
_FIRST_SEED = 970
CAMERAS = ("panorama", "photo", "frames6")
_PHOTO_SHARE = 15 / 16  # of a panorama's width: 1920 x 1440 beside 2048 x 1024


@dataclass(frozen=True)
class CameraQuery:
    """One query: its images, its options as `POST /localize` takes them, the map, and map_from_camera of the first image."""

    camera: str
    images: tuple[Path, ...]
    options: JsonObject
    map_id: str
    pose: Pose


def camera_queries(
    client: PanolocClient, folder: Path, width: int, num_rooms: int, points: int, say: Say
) -> list[CameraQuery]:
    """Make rooms, register their scans, and return the query of each camera in each room.

    width: of the panoramas, pixels. points: of a scan. Raises a ClientError when the service refuses a scan.
    """
    queries = []
    for seed in range(_FIRST_SEED, _FIRST_SEED + num_rooms):
        map_id = None
        for camera in CAMERAS:
            say(f"photographing room {seed - _FIRST_SEED + 1} of {num_rooms}: {camera}")
            name = _SUITE if camera == "panorama" else f"{_SUITE}/{camera}"
            pixels = width if camera == "panorama" else round(width * _PHOTO_SHARE)
            case = next(suite_cases(name, [seed], width=pixels, num_points=points))
            # One scan serves all cameras: a seed always gives the same room.
            map_id = map_id or _registered(client, case, folder / f"room-{seed}.ply")
            images, options = _upload(case, folder / f"room-{seed}-{camera}")
            queries.append(CameraQuery(camera, images, options, map_id, case.pose))
    return queries


def _registered(client: PanolocClient, case: Case, file: Path) -> str:
    write_ply(file, case.cloud)
    place = client.register_map(file, {"name": case.name, "tags": ["bench"]})
    return str(client.wait_for_map(place["id"])["id"])


def _upload(case: Case, stem: Path) -> tuple[tuple[Path, ...], JsonObject]:
    """Write the images of a case as JPEG; return them with the options that describe their cameras."""
    if isinstance(case.query, Panorama):
        return (_jpeg(case.query.color, stem.with_suffix(".jpg")),), {}
    files, cameras = [], []
    for number, image in enumerate(case.query.images):
        files.append(_jpeg(image.photo.color, stem.with_name(f"{stem.name}-{number}.jpg")))
        lens, pose = image.photo.camera, image.session_from_camera
        camera: dict[str, Any] = {
            "model": lens.model,
            "width_px": lens.width_px,
            "height_px": lens.height_px,
            "fx_px": lens.fx_px,
        }
        if len(case.query.images) > 1:
            camera["session_from_camera"] = {
                "position_m": dict(zip("xyz", pose.position.tolist(), strict=True)),
                "quaternion": dict(zip("xyzw", pose.quaternion_xyzw.tolist(), strict=True)),
            }
        cameras.append(camera)
    tracked = {"session": {"up": "known"}} if len(cameras) > 1 else {}
    return tuple(files), {"frame": "ros", "cameras": cameras, **tracked}


def _jpeg(color: Any, file: Path) -> Path:
    buffer = io.BytesIO()
    Image.fromarray(color).save(buffer, "JPEG", quality=92)
    file.write_bytes(buffer.getvalue())
    return file
