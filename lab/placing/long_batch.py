"""Send a thousand small panoramas as one batch, and say how long it takes, how much of it is right, and what the memory does meanwhile.

    python -m lab.placing.long_batch --photos 1000 --width 512

Starts a service of its own with a painted room in it. Prints JSON; `memory_mb` has the proportional memory (PSS) of all its processes
together, and of the HTTP process alone, before the batch and at each tenth of it, which is also told as it comes.
"""

import argparse
import json
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import httpx
import numpy as np

from core.geometry.pose import Pose, pose_error
from lab.benchmark.method.whole_query import encode_jpeg
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.scan_file import write_room_scan
from lab.own_service import OwnService, own_service
from lab.process_memory import family_bytes
from service.client import JsonObject

_SCAN_POINTS = 300_000
_DISTINCT = 50  # photos; the service keeps nothing of one for the next, so that the same again is as good as another
_PAGE = 200
_POLL_S = 1.0
_WITHIN_M, _WITHIN_DEG = 0.3, 10.0
_MB = 1e6
Say = Callable[[str], None]


def measure(service: OwnService, num_photos: int, width: int, say: Say) -> JsonObject:
    """Register a painted room, send the batch, and follow it to its end."""
    room = PaintedRoom(0)
    scan, archive = service.folder / "room.ply", service.folder / "photos.zip"
    write_room_scan(scan, room, _SCAN_POINTS, say)
    place = service.client.wait_for_map(service.client.register_map(scan)["id"])
    poses = _write_photos(archive, room, num_photos, width)
    # What is loaded with the first query is none of the batch's.
    with zipfile.ZipFile(archive) as photos:
        first = Path(photos.extract("0000.jpg", service.folder))
    service.client.localize(first, map_ids=[place["id"]])
    memory: list[JsonObject] = [_memory(service, 0)]
    say(json.dumps(memory[-1]))
    began = time.monotonic()
    with archive.open("rb") as file:
        reply = httpx.post(
            f"{service.url}/batches",
            files={"archive": file},
            data={"map_id": place["id"]},
            timeout=600.0,
            trust_env=False,
        )
    batch = str(reply.raise_for_status().json()["id"])
    for tenth in range(1, 11):
        _wait_for(service, batch, tenth * num_photos // 10)
        memory.append(_memory(service, tenth * num_photos // 10))
        say(json.dumps(memory[-1]))
    seconds = time.monotonic() - began
    items = _items(service, batch)
    right = sum(_is_right(item, pose) for item, pose in zip(items, poses, strict=True))
    localized = sum(item["status"] == "localized" for item in items)
    return {
        "photos": num_photos,
        "width": width,
        "batch_mb": round(archive.stat().st_size / _MB, 1),
        "localized": localized,
        "right": right,
        "seconds": round(seconds, 1),
        "seconds_per_photo": round(seconds / num_photos, 2),
        "memory_mb": memory,
    }


def _write_photos(archive: Path, room: PaintedRoom, num_photos: int, width: int) -> list[Pose]:
    poses = [room.pose(number) for number in range(min(num_photos, _DISTINCT))]
    shown = [encode_jpeg(room.panorama(pose, width)) for pose in poses]
    with zipfile.ZipFile(archive, "w") as photos:
        for number in range(num_photos):
            photos.writestr(f"{number:04}.jpg", shown[number % len(shown)])
    return [poses[number % len(poses)] for number in range(num_photos)]


def _memory(service: OwnService, num_done: int) -> JsonObject:
    found = family_bytes(service.process_id)
    own = sum(size for process, size in found.items() if process.startswith(f"{service.process_id} "))
    return {"done": num_done, "all": round(sum(found.values()) / _MB), "http": round(own / _MB)}


def _wait_for(service: OwnService, batch: str, num_done: int) -> None:
    while True:
        found = _batch(service, batch, 0)
        if _num_done(found) >= num_done:
            return
        time.sleep(_POLL_S)


def _num_done(batch: JsonObject) -> int:
    return sum(count for status, count in batch["counts"].items() if status != "waiting")


def _batch(service: OwnService, batch: str, limit: int, cursor: str | None = None) -> JsonObject:
    at = "" if cursor is None else f"&cursor={cursor}"
    return dict(json.loads(service.client.fetch(f"/batches/{batch}?limit={limit}{at}")))


def _items(service: OwnService, batch: str) -> list[JsonObject]:
    items: list[JsonObject] = []
    cursor: str | None = None
    while True:
        page = _batch(service, batch, _PAGE, cursor)
        items += page["items"]
        cursor = page["next_cursor"]
        if cursor is None:
            return items


def _is_right(item: JsonObject, pose: Pose) -> bool:
    if item["status"] != "localized":
        return False
    matrix = np.asarray(item["answer"]["pose"]["map_from_camera"]["matrix"])
    return pose_error(Pose(matrix[:3, :3], matrix[:3, 3]), pose).within(_WITHIN_M, _WITHIN_DEG)


def main(arguments: list[str]) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description="Follow the memory of one long batch.")
    parser.add_argument("--photos", type=int, default=1000)
    parser.add_argument("--width", type=int, default=512)
    given = parser.parse_args(arguments)
    with own_service() as service:
        figures = measure(service, given.photos, given.width, lambda text: print(text, file=sys.stderr, flush=True))
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
