"""The service that the benchmark sends queries to: the one at `--url`, or one of its own for as long as it is needed."""

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from core.geometry.pose import Pose
from lab.background_service import BackgroundService, start_in_background, wait_until_ready
from lab.benchmark.method.whole_query import encode_jpeg
from lab.benchmark.painted_room import PaintedRoom
from lab.benchmark.request import BenchRequest
from lab.benchmark.rooms import spacing_for
from lab.benchmark.scan_file import write_room_scan
from lab.benchmark.timing import Say
from lab.own_service import free_port
from service.cli.session import Session
from service.client import JsonObject, PanolocClient
from service.host.lifeline import Lifeline

LOG_FILE = "service.log"
SHORT_PREFIX = "pl-"  # a longer path would be too long for the sockets of a service, which would then lie elsewhere
_SAMPLE_POINTS = 100_000


@dataclass(frozen=True)
class KnownPanorama:
    """A JPEG and the pose that it was taken from."""

    file: Path
    pose: Pose


@dataclass(frozen=True)
class MeasuredService:
    """A service with the room to localize in.

    process_id: None for a service that somebody else runs. place: the map. panoramas: all of it.
    """

    url: str
    process_id: int | None
    place: JsonObject
    panoramas: tuple[KnownPanorama, ...]


@contextmanager
def measured_service(request: BenchRequest, session: Session, say: Say) -> Iterator[MeasuredService]:
    """Start a service unless one is given, register the room in it, and stop the service or delete the map at the end.

    Raises a ClientError when the service cannot be reached or started, or refuses the scan.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=SHORT_PREFIX, ignore_cleanup_errors=True)))
        url = request.url or f"http://127.0.0.1:{free_port()}"
        client = stack.enter_context(session.client(url))
        service = _start(stack, url, request, folder) if request.url is None else None
        wait_until_ready(client, service, say)
        panoramas = _make_room(request, folder, say)
        say("registering the room")
        place = client.register_map(folder / "room.ply", _options(request))
        if request.url is not None:
            stack.callback(client.delete_map, place["id"])
        process_id = None if service is None else service.process_id
        yield MeasuredService(url, process_id, _when_ready(client, place, say), panoramas)


def _start(stack: ExitStack, url: str, request: BenchRequest, folder: Path) -> BackgroundService:
    """Start a service that ends with `stack`, and also when this process is killed."""
    lifeline = Lifeline()
    stack.callback(lifeline.close)
    service = start_in_background(url, request.out / LOG_FILE, _settings(request, folder))
    lifeline.guard(service.process_id)
    stack.callback(lifeline.release, service.process_id)
    stack.callback(service.stop)
    return service


def _settings(request: BenchRequest, folder: Path) -> dict[str, str]:
    """Return what a service of our own is told; whatever else the environment says holds for it as well."""
    told = {
        "PANOLOC_DATA_DIR": str(folder / "data"),
        "PANOLOC_MAX_TIMEOUT_S": f"{max(request.paper_timeout_s, 600):g}",
    }
    # Workers take a GPU where they see one.
    return told | ({"CUDA_VISIBLE_DEVICES": ""} if request.device == "cpu" else {})


def _make_room(request: BenchRequest, folder: Path, say: Say) -> tuple[KnownPanorama, ...]:
    room, sizes = PaintedRoom(0), request.sizes
    write_room_scan(folder / "room.ply", room, sizes.points, say)
    panoramas = []
    for number in range(sizes.num_panoramas):
        say(f"taking panorama {number + 1} of {sizes.num_panoramas}")
        pose, file = room.pose(number), folder / f"panorama-{number}.jpg"
        file.write_bytes(encode_jpeg(room.panorama(pose, sizes.width)))
        panoramas.append(KnownPanorama(file, pose))
    return tuple(panoramas)


def _options(request: BenchRequest) -> JsonObject:
    sizes = request.sizes
    spacing_m = spacing_for(PaintedRoom(0).scan(min(sizes.points, _SAMPLE_POINTS)), sizes.starts)
    return {"name": "panoloc bench", "tags": ["bench"], "starts": {"spacing_m": round(spacing_m, 4)}}


def _when_ready(client: PanolocClient, place: JsonObject, say: Say) -> JsonObject:
    return client.wait_for_map(
        place["id"], lambda now: say(f"registering the room: {now['status']} {now.get('stage') or ''}")
    )
