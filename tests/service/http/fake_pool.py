"""A pool without processes: it answers from a script and keeps what it was asked."""

import asyncio
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.camera.rig import Panorama, Photo
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Status
from panoloc.core.results import Candidate, FoundImage, Localization, SearchSummary
from panoloc.service.cache import WorkerCache
from panoloc.service.errors import NoWorkerError, QueueFullError
from panoloc.service.http.schemas.examples import MAP_EXAMPLE
from panoloc.service.jobs import (
    LocalizeJob,
    LocalizeOutcome,
    PoolState,
    RegisterJob,
    RegisterOutcome,
    at_once,
)
from panoloc.service.worker.answers import answer_of

PNG = b"\x89PNG\r\n\x1a\n a picture"
INDEX_DIGEST = "0123abcd"
PHOTO = Photo.of_panorama(Panorama(np.zeros((4, 8, 3), np.uint8), np.ones((4, 8), bool)))


def ply_of(points: list[tuple[float, float, float]]) -> bytes:
    """Return a PLY as workers write it, every point grey."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    body = b"".join(struct.pack("<fffBBB", *point, 128, 128, 128) for point in points)
    return ("\n".join([*header, "end_header"]) + "\n").encode() + body


POSE = Pose(np.eye(3), np.array([1.2, 0.3, 1.5]))


def outcome_of(
    job: LocalizeJob,
    pose: Pose = POSE,
    status: Status = "localized",
    found_camera: CameraDescription | None = None,
) -> LocalizeOutcome:
    """Return what a worker finds for every panorama. found_camera: in place of the one that a photo has."""
    best = Candidate(pose, 0, 0.93, 5.0, 0.11, "equalized", 60)
    search, timings_s = SearchSummary(job.options.method, 1, 412, 2304, 900_000), {"decode": 0.03, "search": 0.06}
    images = (FoundImage(pose, 0.7),) * len(job.images)
    found = Localization(status, search, timings_s, best, (), 0.02, 0.3, 0.18, 0.11, images=images)
    if (first := job.images[0].session_from_camera) is not None:
        session_from_camera = Pose.from_frame(first.position_m, first.quaternion_xyzw, job.options.frame)
        found = replace(found, map_from_session=pose.after(session_from_camera.inverse()))
    pictures: dict[str, bytes] = {name: PNG + name.encode() for name in job.options.artifacts}
    cameras = [found_camera or each.camera for each in job.images]
    photos = [PHOTO if camera is None else described_photo(camera) for camera in cameras]
    return LocalizeOutcome(answer_of(found, job, photos, {}, pictures), pictures)


def described_photo(camera: CameraDescription) -> Photo:
    """Return a small photo of a camera."""
    return Photo(PHOTO.color, PHOTO.valid, camera.of_image((8, 4), (8, 4)))


IN_UTM = {"min": [691_000.0, 5_335_000.0, 500.0], "max": [691_012.0, 5_335_008.0, 503.0]}
"""Bounds of a scan in EPSG:25832."""


@dataclass
class FakePool:
    """`fail_localize` and `fail_register` are raised, in turn, `full` as long as it is set; closed gates hold work, or its end,
    back. asked: set once a query came. doubts: diagnostics of every map. bounds: of every scan, without those of an example."""

    worker_cache: WorkerCache
    is_ready: bool = True
    fail_localize: list[Exception] = field(default_factory=list)
    fail_register: list[Exception] = field(default_factory=list)
    doubts: list[dict[str, Any]] = field(default_factory=list)
    bounds: dict[str, list[float]] | None = None
    register_gate: asyncio.Event = field(default_factory=asyncio.Event)
    localize_gate: asyncio.Event = field(default_factory=asyncio.Event)
    full: QueueFullError | None = None
    end_gate: asyncio.Event = field(default_factory=asyncio.Event)
    asked: asyncio.Event = field(default_factory=asyncio.Event)
    jobs: list[LocalizeJob] = field(default_factory=list)
    registrations: list[RegisterJob] = field(default_factory=list)
    ended: list[str] = field(default_factory=list)
    outcome_of: Callable[[LocalizeJob], LocalizeOutcome] = outcome_of
    started: bool = False
    stopped: bool = False
    num_under_way: int = 0

    def __post_init__(self) -> None:
        self.register_gate.set()
        self.localize_gate.set()
        self.end_gate.set()

    async def start(self) -> None:
        self.started = True

    def begin_drain(self) -> None:
        self.num_under_way = 0

    async def stop(self, drain_s: float) -> None:
        self.stopped = True

    def require_place(self, longest_s: float) -> None:
        if self.full is not None:
            raise self.full

    async def localize(self, job: LocalizeJob) -> LocalizeOutcome:
        self.jobs.append(job)
        self.asked.set()
        await self._pass(self.localize_gate, "localize")
        if self.fail_localize:
            raise self.fail_localize.pop(0)
        return self.outcome_of(job)

    async def register(self, job: RegisterJob, begin: Callable[[], Awaitable[None]] = at_once) -> RegisterOutcome:
        await begin()
        self.registrations.append(job)
        await asyncio.to_thread(self.worker_cache.report_progress, job.map, "indexing", "rendering starts", 0.4)
        await self._pass(self.register_gate, "register")
        if self.fail_register:
            raise self.fail_register.pop(0)
        await asyncio.to_thread(self.worker_cache.put_index, job.map, INDEX_DIGEST, b"index")
        starts = [{"position_m": [1.0, 2.0, 1.5], "leaf_size_m": 0.5}]
        example: dict[str, Any] = MAP_EXAMPLE
        points = ply_of([(float(number), 0.0, 1.0) for number in range(10)])
        unit = "m" if job.options.scan.unit == "auto" else job.options.scan.unit
        read_as = {"unit": unit, "height_unit": unit, "up_axis": "z"}
        read_as |= dict.fromkeys(("unit_from", "height_unit_from", "up_axis_from"), "assumed")
        stats = {**example["stats"], "read_as": read_as, "bounds": self.bounds or example["stats"]["bounds"]}
        return RegisterOutcome(stats, example["diagnostics"] + self.doubts, PNG, points, starts)

    def state(self) -> PoolState:
        state = PoolState(ready=True, waiting_for=None, num_workers=1, resident_bytes=17, index_loads={"redis": 2})
        return state if self.is_ready else replace(state, ready=False, waiting_for="workers", num_workers=0)

    async def _pass(self, gate: asyncio.Event, what: str) -> None:
        try:
            await gate.wait()
        except asyncio.CancelledError:
            self.ended.append(what)
            await self.end_gate.wait()
            raise


def no_worker() -> NoWorkerError:
    """Return what a pool raises whose worker has just gone."""
    return NoWorkerError("the worker was lost", retry_after_s=0)
