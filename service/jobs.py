"""Between the HTTP process and the workers: jobs, outcomes, and the protocol of a pool.

Imports neither Ray nor torch. `panoloc.service.app.create_app` gets a pool, starts it with the application and stops it
at the end.
"""

import secrets
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.options import Frame, Hints, IndexOptions, Method, ScanOptions, SessionOptions, TrackedPose
from panoloc.core.remarks import Remark

if TYPE_CHECKING:
    from panoloc.service.answer import Localization

Artifact = Literal["score_map_2d", "score_map_3d", "overlay"]
ARTIFACTS: tuple[Artifact, ...] = get_args(Artifact)
"""The pictures that a query may ask for; keys of `LocalizeOutcome.pictures`."""

LONGEST_NAME, LONGEST_TAG = 200, 64
"""Characters of a map's name and of a tag."""

PAPER_TIMEOUT_S = 600.0
"""Seconds for a query of the method `paper` that names none: one to three minutes on two cores, docs/experiments.md."""


ON_EARTH = ("georeference", "coordinate_system", "geoid_undulation_m")
"""Fields of a map's document about its place on Earth."""

Result = dict[str, Any]
"""Result of one image of a batch: `status`, and `answer` (body of `POST /localize`) or `error` (problem document)."""


def new_id(prefix: str) -> str:
    """Return `prefix_` and 16 random hexadecimal digits."""
    return f"{prefix}_{secrets.token_hex(8)}"


def now() -> str:
    """Return the time in UTC as RFC 3339, always with microseconds: text sorts like time."""
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


@dataclass(frozen=True)
class MapRef:
    """One revision of one map. Revisions count from 1; the bytes behind a revision never change."""

    id: str
    revision: int


@dataclass(frozen=True)
class QueryOptions:
    """Options of one query.

    timeout_s: seconds for the answer. frame: axes of all poses, sent and returned. session: accuracy of the tracked
    poses. top_k: most poses in the answer. artifacts: without duplicates.
    """

    timeout_s: float
    method: Method = "fast"
    frame: Frame = "ros"
    session: SessionOptions = field(default_factory=SessionOptions)
    hints: Hints | None = None
    artifacts: tuple[Artifact, ...] = ()
    top_k: int = 1


@dataclass(frozen=True)
class QueryImage:
    """One image of a query.

    data, mask: the uploaded files (`KNOWN_FORMATS`), not decoded. camera: None to take it from the file's metadata.
    session_from_camera: the pose that the device tracked; None for a single image without one.
    """

    data: bytes
    mask: bytes | None = None
    camera: CameraDescription | None = None
    session_from_camera: TrackedPose | None = None


@dataclass(frozen=True)
class LocalizeJob:
    """One query.

    images: at least one; of several, each has its pose. maps: at least one, all ready. deadline_unix_s: nobody waits
    for the answer after it. georeferences: by map id, of the maps that have one, as `panoloc.core.earth.geopose.geopose_of`
    takes it. share: the name of a part of the maps of a query, of which only the scores are asked for. num_maps: where the maps are the
    likeliest of so many, best first. along_walls: the image is what a map shows from a place, upright and along its walls. keep_photo: a
    small photo may be kept, in which objects that changed are found.
    """

    localization_id: str
    request_id: str
    images: tuple[QueryImage, ...]
    maps: tuple[MapRef, ...]
    options: QueryOptions
    deadline_unix_s: float
    georeferences: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    keep_photo: bool = False
    share: str | None = None
    num_maps: int | None = None
    along_walls: bool = False

    @property
    def kind(self) -> str:
        """Return the key under which query durations are averaged: method, and whether a field of view is searched."""
        is_searching = any(image.camera is not None and image.camera.hfov_range_deg for image in self.images)
        return f"{self.options.method}, searching field of view" if is_searching else self.options.method


@dataclass(frozen=True)
class ChangePhoto:
    """A small photo that shows what changed: a panorama as WebP, transparent where nothing was photographed, and where it was taken.

    position_m, quaternion_xyzw: map_from_camera in the map's own frame.
    """

    webp: bytes
    position_m: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


@dataclass(frozen=True)
class LocalizeOutcome:
    """The result of one query.

    pictures: PNGs by name, those of `options.artifacts` that could be drawn. change_cells: by
    `panoloc.service.worker.answers.change_cells`. change_photo: by `panoloc.service.worker.answers.change_photo`.
    """

    answer: "Localization"
    pictures: dict[str, bytes] = field(default_factory=dict)
    change_cells: dict[str, Any] | None = None
    change_photo: ChangePhoto | None = None

    def without_maps(self, left_out: Mapping[MapRef, Exception]) -> "LocalizeOutcome":
        """Return the outcome with a warning for each map that could not be searched, and why not."""
        remarks = [Remark("map_left_out", f"{ref.id} was left out: {error}") for ref, error in left_out.items()]
        return replace(self, answer=self.answer.with_remarks(remarks))


@dataclass(frozen=True)
class RegisterOptions:
    """Options of a registration. scan: the worker adds format and limits."""

    scan: ScanOptions = field(default_factory=ScanOptions)
    index: IndexOptions = field(default_factory=IndexOptions)


@dataclass(frozen=True)
class RegisterJob:
    """One revision of a scan that becomes a map.

    scan_key: of the scan in storage, with the file's extension when it has one. scan_name: the file's name at the
    client. time_limit_s: seconds once it runs, None for no limit. The worker reports progress by
    `WorkerCache.report_progress`.
    """

    map: MapRef
    scan_key: str
    scan_name: str
    options: RegisterOptions
    request_id: str
    time_limit_s: float | None = None


@dataclass(frozen=True)
class RegisterOutcome:
    """The result of a registration, besides the index, which the worker itself puts into Redis.

    stats and diagnostics: as in the map of the HTTP contract. preview_png: the scan from above.
    points_ply: binary little-endian PLY of at most `MAX_SAMPLE_POINTS` coloured points in the map's own frame,
    shuffled, so that every prefix is a fair sample; empty when there is none. starts: one `{"position_m": [x, y, z],
    "leaf_size_m": s}` per start, metres, in the map's own frame.
    """

    stats: dict[str, Any]
    diagnostics: list[dict[str, Any]]
    preview_png: bytes
    points_ply: bytes = b""
    starts: list[dict[str, Any]] = field(default_factory=list)


MAX_SAMPLE_POINTS = 10_000_000
"""In `RegisterOutcome.points_ply`, which then takes 150 MB. By default a scan is thinned to fewer."""


@dataclass(frozen=True)
class PoolState:
    """What readiness and metrics tell about the pool.

    waiting_for: what is missing, in words that follow "waiting for", None when ready. resident_bytes: of map indexes
    in the memory of all workers. index_loads: how often an index was "resident", came from "redis" or "storage" or was "missing",
    since the start. num_retries: queries that were given to another worker because theirs was lost.
    """

    ready: bool
    waiting_for: str | None
    num_workers: int = 0
    queue_depth: int = 0
    resident_bytes: int = 0
    index_loads: dict[str, int] = field(default_factory=dict)
    num_retries: int = 0


async def at_once() -> None:
    """Begin a registration without anything before it."""


class WorkerPool(Protocol):
    """Computes localizations and map indexes somewhere else. Used from one event loop."""

    async def start(self) -> None:
        """Begin to bring workers up and return at once; `state` tells when they are."""

    @property
    def num_under_way(self) -> int:
        """Return how many queries wait or run."""

    def begin_drain(self) -> None:
        """Refuse new requests from now on; those under way go on."""

    async def stop(self, drain_s: float) -> None:
        """Take nothing more, wait up to `drain_s` for what is under way, then end the workers."""

    def require_place(self, longest_s: float) -> None:
        """Raise QueueFullError where a query that came now would be refused whatever it asks; never blocks.

        longest_s: that it may allow for its answer.
        """

    async def localize(self, job: LocalizeJob) -> LocalizeOutcome:
        """Answer one query; cancelling the call drops it.

        Raises QueueFullError, NoWorkerError, CacheDownError, exceptions of `core`, or WorkerError for a worker's own fault.
        """

    async def register(self, job: RegisterJob, begin: Callable[[], Awaitable[None]] = at_once) -> RegisterOutcome:
        """Build the index of one revision and put it into Redis; cancelling the call ends the work.

        Calls wait for each other inside the pool; `begin` is awaited when the turn of this one has come, and what it raises ends
        the call. Raises NoWorkerError and CacheDownError (tried again later); after an exception of `core`, a WorkerError or a
        RegistrationLimitError (too long) the map has failed.
        """

    def state(self) -> PoolState:
        """Return the pool's state now; never blocks."""
