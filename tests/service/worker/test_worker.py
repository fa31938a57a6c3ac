"""The worker and the registrar without Ray: a real index, a real Redis, a folder; only the search is made up."""

import hashlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import redis
import torch

from core.geometry.pose import Pose
from core.index.map_index import MapIndex
from core.options import MIN_POINTS, IndexOptions, ScanOptions
from core.panorama.panorama import Panorama
from core.results import Candidate, Localization, SearchSummary
from core.scan import readers
from core.scan.ply.writer import encode_ply
from core.scan.point_cloud import PointCloud
from service.cache import WorkerCache
from service.errors import StorageFullError
from service.host.embedded_redis import EmbeddedRedis
from service.host.lifeline import Lifeline
from service.jobs import LocalizeJob, MapRef, QueryImage, QueryOptions, RegisterJob, RegisterOptions
from service.maps.record import MapRecord, Revision, key_of, write_record
from service.settings import Settings
from service.storage import FolderStorage
from service.worker.localization_worker import LocalizationWorker
from service.worker.map_catalog import MapCatalog
from service.worker.plan import WorkerSettings
from service.worker.registrar import Registrar
from tests.core.scan.mesh_files import zip_of

MAP = MapRef("map_box", 1)
OPTIONS = RegisterOptions(ScanOptions(), IndexOptions("grid", 2.0))


class MadeUpLocalizer:
    """Finds the first start of the first map, and remembers what it was asked."""

    device = torch.device("cpu")

    def __init__(self) -> None:
        self.calls: list[dict[str, Any]] = []

    def localize(self, panorama: Panorama, maps: Sequence[MapIndex], **options: Any) -> Localization:
        self.calls.append(options)
        best = Candidate(Pose(np.eye(3), maps[0].start_positions[0]), 0, 0.9, 1.0, 0.1, "none", 10)
        search = SearchSummary("fast", len(maps), 1, 1, 1)
        return Localization("localized", search, {"search": 0.01}, best, (), 0.01, 0.1, 0.0, 0.0)


@dataclass
class Place:
    registrar: Registrar
    worker: LocalizationWorker
    localizer: MadeUpLocalizer
    redis: "redis.Redis"
    folder: Path
    job: RegisterJob


@pytest.fixture
def place() -> Iterator[Place]:
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory(prefix="pl-") as name:
        folder, lifeline = Path(name), Lifeline()
        server = EmbeddedRedis(folder, lifeline)
        server.start()
        storage = FolderStorage(folder / "data")
        job = store_box(storage)
        settings = WorkerSettings.of(Settings(data_dir=folder / "data"), server.url)
        cache, localizer = WorkerCache(server.url, index_lifetime_s=60), MadeUpLocalizer()
        yield Place(
            Registrar(settings, MapCatalog(storage), cache),
            LocalizationWorker(settings, localizer, MapCatalog(storage), cache),  # type: ignore[arg-type]
            localizer,
            redis.Redis.from_url(server.url),
            folder,
            job,
        )
        server.stop()
        lifeline.close()


def store_box(storage: FolderStorage) -> RegisterJob:
    """Put the scan and the record of a coloured box of 4 x 4 x 2.5 m into storage."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (20_000, 3)) * [2, 2, 1.25]
    side = rng.integers(0, 3, len(points))
    walls = np.sign(points) * [2, 2, 1.25]
    points[np.arange(len(points)), side] = walls[np.arange(len(points)), side]
    colors = (127 + 60 * np.sin(3 * points)).astype(np.uint8)
    scan = encode_ply(PointCloud(points.astype(np.float32), colors))
    key, now = key_of(MAP, "scan.ply"), "2026-01-01T00:00:00Z"
    storage.put(key, scan)
    revision = Revision(1, key, "box.ply", len(scan), hashlib.sha256(scan).hexdigest(), OPTIONS)
    write_record(storage, MapRecord(MAP.id, "box", now, now, revision))
    return RegisterJob(MAP, key, "box.ply", OPTIONS, "req_1")


def query(panorama: bytes | None = None, seconds: float = 30, maps: tuple[MapRef, ...] = (MAP,)) -> LocalizeJob:
    options = QueryOptions(seconds, artifacts=("overlay",), top_k=3)
    return LocalizeJob(
        "loc_1", "req_2", (QueryImage(panorama or grey_png()),), maps, options, deadline_unix_s=time.time() + seconds
    )


def grey_png() -> bytes:
    from core.pictures import encode_png

    return encode_png(np.full((128, 256, 3), 128, dtype=np.uint8))


@pytest.mark.slow
def test_a_registered_map_is_in_redis_and_describes_itself(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    # The process that has the token of Ray parses no scan itself.
    monkeypatch.setattr(readers, "READERS", {})
    reply = place.registrar.register(place.job)
    assert reply.failure is None
    assert reply.outcome is not None
    stats = reply.outcome.stats
    assert stats["num_points"] == 20_000
    assert stats["bounds"]["max"] == pytest.approx([2, 2, 1.25], abs=0.01)
    assert stats["num_starts"] == len(reply.outcome.starts) > 0
    assert set(stats["seconds"]) == {"read", "starts", "render", "describe", "store"}
    (key,) = place.redis.keys("index:*")
    assert place.redis.strlen(key) == stats["index_bytes"]
    assert place.redis.ttl(key) > 0
    assert reply.outcome.preview_png.startswith(b"\x89PNG")
    assert reply.outcome.points_ply.startswith(b"ply\n")


@pytest.mark.slow
def test_a_map_whose_starts_lie_beside_the_scan_becomes_ready_with_diagnostics(place: Place) -> None:
    assert place.registrar.register(place.job).outcome.diagnostics == []  # type: ignore[union-attr]
    beside = replace(OPTIONS.index, region=((30.0, 30.0, 0.5), (32.0, 33.0, 1.5)))
    reply = place.registrar.register(replace(place.job, options=replace(OPTIONS, index=beside)))
    assert reply.outcome is not None
    assert [each["code"] for each in reply.outcome.diagnostics] == ["starts_see_little", "region_outside_scan"]
    assert {each["severity"] for each in reply.outcome.diagnostics} == {"warning"}


@pytest.mark.slow
def test_a_query_takes_the_index_from_redis_once_and_keeps_it(place: Place) -> None:
    place.registrar.register(place.job)
    first, second = place.worker.localize(query()), place.worker.localize(query())
    assert (first.failure, second.failure) == (None, None)
    assert first.index_loads == {"redis": 1}
    assert second.index_loads == {"resident": 1}
    assert second.resident_bytes > 100_000
    assert first.outcome is not None
    assert first.outcome.best is not None
    assert first.outcome.best.map == MAP
    assert list(first.outcome.pictures) == ["overlay"]
    assert {"load", "decode", "search", "pictures"} <= set(first.outcome.timings_s)


@pytest.mark.slow
def test_the_search_gets_the_options_and_what_is_left_of_the_time(place: Place) -> None:
    place.registrar.register(place.job)
    place.worker.localize(query(seconds=20))
    (call,) = place.localizer.calls
    assert (call["method"], call["hints"], call["top_k"]) == ("fast", None, 3)
    assert 15 < call["timeout_s"] <= 20


@pytest.mark.slow
def test_an_index_that_redis_has_lost_comes_back_from_its_copy_without_being_built(place: Place) -> None:
    place.registrar.register(place.job)
    (key,) = place.redis.keys("index:*")
    before: Any = place.redis.get(key)
    place.redis.flushall()
    reply = place.worker.localize(query())
    assert (reply.failure, reply.missing, reply.index_loads) == (None, (), {"storage": 1})
    assert place.redis.get(key) == before


@pytest.mark.slow
@pytest.mark.parametrize("room", [True, False])
def test_a_copy_that_is_damaged_or_was_never_written_is_none(
    place: Place, monkeypatch: pytest.MonkeyPatch, room: bool
) -> None:
    if not room:

        def full(*_: object) -> None:
            raise StorageFullError("the disk is full")

        monkeypatch.setattr(FolderStorage, "put", full)
    assert place.registrar.register(place.job).failure is None
    for copy in copies(place):
        copy.write_bytes(copy.read_bytes()[:-100])
    assert bool(copies(place)) == room
    place.redis.flushall()
    assert place.worker.localize(query()).missing == (MAP,)


def copies(place: Place) -> list[Path]:
    return list((place.folder / "data" / "maps").rglob("*.plmi"))


@pytest.mark.slow
def test_an_index_that_is_lost_with_its_copy_is_reported_and_can_be_built_again(place: Place) -> None:
    place.registrar.register(place.job)
    place.redis.flushall()
    for copy in copies(place):
        copy.unlink()
    reply = place.worker.localize(query())
    assert (reply.outcome, reply.failure, reply.missing) == (None, None, (MAP,))
    assert place.registrar.rebuild(MAP).failure is None
    assert place.worker.localize(query()).outcome is not None


@pytest.mark.slow
@pytest.mark.parametrize("way", ["register", "rebuild"])
def test_an_index_whose_map_was_deleted_while_it_was_built_is_not_kept(
    place: Place, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    put = WorkerCache.put_index

    def put_too_late(cache: WorkerCache, ref: MapRef, digest: str, data: bytes) -> None:
        FolderStorage(place.folder / "data").delete_all(f"maps/{ref.id}")
        put(cache, ref, digest, data)

    monkeypatch.setattr(WorkerCache, "put_index", put_too_late)
    reply = place.registrar.register(place.job) if way == "register" else place.registrar.rebuild(MAP)
    assert reply.failure is not None
    assert reply.failure.kind == "MapNotFoundError"
    assert place.redis.keys("index:*") == []
    assert copies(place) == []


def test_a_query_past_its_deadline_is_not_begun(place: Place) -> None:
    reply = place.worker.localize(query(seconds=-1))
    assert reply.failure is not None
    assert reply.failure.kind == "DeadlineExceededError"
    assert place.localizer.calls == []


@pytest.mark.slow
def test_what_is_no_image_fails_by_the_name_of_its_error(place: Place) -> None:
    place.registrar.register(place.job)
    reply = place.worker.localize(query(panorama=b"this is text"))
    assert reply.failure is not None
    assert reply.failure.kind == "PanoramaFormatError"


def test_a_map_deleted_meanwhile_is_not_found(place: Place) -> None:
    reply = place.worker.localize(query(maps=(MapRef("map_gone", 1),)))
    assert reply.failure is not None
    assert reply.failure.kind == "MapNotFoundError"


def test_a_scan_that_changed_on_disk_is_not_registered(place: Place) -> None:
    (place.folder / "data" / place.job.scan_key).write_bytes(b"ply\n")
    reply = place.registrar.register(place.job)
    assert reply.failure is not None
    assert reply.failure.kind == "StoredFileDamagedError"


def test_remains_of_a_killed_process_go_with_the_next_registration_of_any_scan(place: Place) -> None:
    uploads = place.folder / "data" / "uploads"
    uploads.mkdir(parents=True, exist_ok=True)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    remains = uploads / f"panoloc-zip-{socket.gethostname()}-{gone.pid}-x"
    own = uploads / f"panoloc-zip-{socket.gethostname()}-{os.getpid()}-x"
    for folder in (remains, own):
        (folder / "scans").mkdir(parents=True)
    place.registrar._remove_remains()
    assert (remains.exists(), own.exists()) == (False, True)


def test_a_scan_of_a_handful_of_points_is_no_map(place: Place) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (MIN_POINTS - 1, 3)).astype(np.float32)
    scan = encode_ply(PointCloud(points, np.full((len(points), 3), 99, np.uint8)))
    FolderStorage(place.folder / "data").put(place.job.scan_key, scan)
    failure = place.registrar.register(place.job).failure
    assert failure is not None
    assert failure.kind == "ScanContentError"
    assert f"99 points; expected at least {MIN_POINTS}" in failure.message


def test_a_copy_of_an_index_takes_the_place_of_those_of_other_configurations(place: Place) -> None:
    storage = FolderStorage(place.folder / "data")
    catalog = MapCatalog(storage)
    for digest in ("0123", "4567"):
        catalog.store_index(MAP, digest, digest.encode())
    assert catalog.stored_index(MAP, "4567") == b"4567"
    assert catalog.stored_index(MAP, "0123") is None
    left = {path.name for path in (place.folder / "data" / "maps" / MAP.id / "1").iterdir()}
    assert left == {"scan.ply", "scan.ply.sha256", "index-4567.plmi", "index-4567.plmi.sha256"}


@pytest.mark.slow
def test_a_zip_is_unpacked_on_the_disk_of_the_scans(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    storage = FolderStorage(place.folder / "data")
    storage.put(key_of(MAP, "scan.zip"), zip_of({"box.ply": storage.read(place.job.scan_key)}))
    monkeypatch.setattr("tempfile.tempdir", str(place.folder / "no such folder"))
    job = replace(place.job, scan_key=key_of(MAP, "scan.zip"), scan_name="box.zip")
    assert place.registrar.register(job).failure is None
    assert storage.names("uploads") == []


@pytest.mark.parametrize("lack", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: 9 bytes")])
def test_a_scan_that_finds_no_memory_is_told_which_limit_it_met(
    place: Place, monkeypatch: pytest.MonkeyPatch, lack: Exception
) -> None:
    def read(*_: object) -> None:
        raise lack

    monkeypatch.setattr("service.worker.registrar.read_scan", read)
    failure = place.registrar.register(place.job).failure
    assert failure is not None
    assert failure.kind == "RegistrationLimitError"
    assert "PANOLOC_REGISTRATION_MEMORY_BYTES" in failure.message


@pytest.mark.slow
def test_the_limits_of_the_process_grow_with_the_scan(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[tuple[int, float]] = []
    settings = WorkerSettings.of(Settings(registration_memory_bytes=2**28), "redis://")
    catalog = MapCatalog(FolderStorage(place.folder / "data"))
    registrar = Registrar(settings, catalog, place.registrar._cache, lambda *limits: given.append(limits))
    registrar.register(place.job)
    scan_bytes = len(FolderStorage(place.folder / "data").read(place.job.scan_key))
    assert [num_bytes for num_bytes, _ in given] == [2**28 + 8 * scan_bytes]
    assert all(cpu_s >= settings.registration_limits.seconds(scan_bytes) for _, cpu_s in given)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        lambda data: b"",
        lambda data: data[:10] + b"\xff\x00{" + data[13:],
        lambda data: data[:4] + b"\xff\xff" + data[6:],
        lambda data: b"something else",
    ],
    ids=["truncated", "empty", "damaged header", "foreign version", "foreign"],
)
def test_an_index_that_cannot_be_read_is_built_again_like_one_that_is_lost(
    place: Place, damage: Callable[[bytes], bytes]
) -> None:
    place.registrar.register(place.job)
    (key,) = place.redis.keys("index:*")
    for copy in copies(place):
        copy.unlink()
    kept: Any = place.redis.get(key)
    place.redis.set(key, damage(kept), ex=60)
    reply = place.worker.localize(query())
    assert (reply.failure, reply.missing) == (None, (MAP,))
    assert place.registrar.rebuild(MAP).failure is None
    assert place.worker.localize(query()).missing == ()
