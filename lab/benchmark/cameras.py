"""How long queries of several cameras take over HTTP: a panorama, a photo and six frames from the same places in furnished rooms.

They are sent in turn, so that whatever else the machine does meets them alike.
"""

import tempfile
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

from PIL import Image

from panoloc.core.config import DISTANCES
from panoloc.core.scan.ply.writer import write_ply
from panoloc.lab.benchmark.query_load import KnownQuery, send_queries
from panoloc.lab.benchmark.sizes import Sizes
from panoloc.lab.benchmark.timing import Say, spread_of
from panoloc.lab.rooms import Case, suite_cases
from panoloc.service.cli.session import Session
from panoloc.service.client import JsonClient, JsonObject

_SUITE = "changed"  # furniture moves between the scan and the photo, as it does
_FIRST_SEED = 970
_CAMERAS = ("panorama", "photo", "frames6")
_PHOTO_SHARE = 15 / 16  # of a panorama's width: 1920 x 1440 beside 2048 x 1024


def measure_cameras(session: Session, url: str, sizes: Sizes, say: Say) -> list[dict[str, Any]]:
    """Return the figures of each camera in furnished rooms of which 60 % has changed; each room's queries are sent repeatedly.

    right: answers within 0.3 m and 10 degrees, sure or not. ratio: of the median latency to that of panoramas.
    Raises a ClientError when the service refuses a scan or a query.
    """
    with tempfile.TemporaryDirectory(prefix="pl-") as folder, session.client(url) as client:
        queries = _make_queries(client, Path(folder), sizes, say)
        in_turn = [query for group in zip(*queries.values(), strict=True) for query in group]
        try:
            say("queries of every camera")
            # Once more than counts: the first time the map is loaded.
            answers, errors = send_queries(session, url, in_turn * (1 + sizes.repeats), 1)
        finally:
            for map_id in {query.map_id for query in in_turn}:
                client.delete_map(map_id)
    if errors:
        raise errors[-1]
    counted = answers[len(in_turn) :]
    given = {camera: [answer for answer in counted if answer.query in own] for camera, own in queries.items()}
    latency = {camera: spread_of([answer.milliseconds for answer in of]) for camera, of in given.items()}
    return [
        {
            "camera": camera,
            "images": len(queries[camera][0].images),
            "queries": len(of),
            "localized": sum(answer.is_localized for answer in of),
            "right": sum(answer.error is not None and answer.error.within(*astuple(DISTANCES.right)) for answer in of),
            "latency": asdict(latency[camera]),
            "ratio": latency[camera].median_ms / latency["panorama"].median_ms,
        }
        for camera, of in given.items()
    ]


def _make_queries(client: JsonClient, folder: Path, sizes: Sizes, say: Say) -> dict[str, list[KnownQuery]]:
    """Make rooms, register their scans, and return the query of each camera in each room."""
    queries: dict[str, list[KnownQuery]] = {camera: [] for camera in _CAMERAS}
    for seed in range(_FIRST_SEED, _FIRST_SEED + sizes.camera_rooms):
        map_id = None
        for camera, own in queries.items():
            say(f"photographing room {seed - _FIRST_SEED + 1} of {sizes.camera_rooms}: {camera}")
            name = _SUITE if camera == "panorama" else f"{_SUITE}/{camera}"
            pixels = sizes.width if camera == "panorama" else round(sizes.width * _PHOTO_SHARE)
            case = next(suite_cases(name, [seed], width=pixels, num_points=sizes.camera_points))
            # One scan serves all cameras: a seed always gives the same room.
            map_id = map_id or _registered(client, case, folder / f"room-{seed}.ply")
            images, options = _upload(case, folder / f"room-{seed}-{camera}")
            own.append(KnownQuery(images, map_id, case.pose, options))
    return queries


def _registered(client: JsonClient, case: Case, file: Path) -> str:
    write_ply(file, case.cloud)
    place = client.register_map(file, {"name": case.name, "tags": ["bench"]})
    return str(client.wait_for_map(place["id"])["id"])


def _upload(case: Case, stem: Path) -> tuple[tuple[Path, ...], JsonObject]:
    """Write the images of a case as JPEG; return them with the options that describe their cameras."""
    if case.query.photos[0].camera.is_whole_sphere:
        return (_jpeg(case.query.photos[0].color, stem.with_suffix(".jpg")),), {}
    files, cameras = [], []
    for number, image in enumerate(case.query.images):
        files.append(_jpeg(image.photo.color, stem.with_name(f"{stem.name}-{number}.jpg")))
        lens, pose = image.photo.camera, image.session_from_camera
        names = ("model", "width_px", "height_px", "fx_px")
        camera: dict[str, Any] = {name: getattr(lens, name) for name in names}
        if len(case.query.images) > 1:
            camera["session_from_camera"] = {
                "position_m": dict(zip("xyz", pose.position.tolist(), strict=True)),
                "quaternion": dict(zip("xyzw", pose.quaternion_xyzw.tolist(), strict=True)),
            }
        cameras.append(camera)
    tracked = {"session": {"up": "known"}} if len(cameras) > 1 else {}
    return tuple(files), {"frame": "ros", "cameras": cameras, **tracked}


def _jpeg(color: Any, file: Path) -> Path:
    Image.fromarray(color).save(file, quality=92)
    return file
