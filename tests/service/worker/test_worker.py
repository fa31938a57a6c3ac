"""The worker and the registrar without Ray: a real index, a real Redis, a folder; only the search is made up."""

import hashlib
import io
import json
import os
import pickle
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import redis
import torch
from PIL import Image

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.pictures import encode_png
from panoloc.core.geometry.pose import Pose
from panoloc.core.map.map_builder import build_map_index, index_config_digest
from panoloc.core.map.map_codec import encode_map_index
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import MIN_POINTS, IndexOptions, ScanOptions
from panoloc.core.results import Candidate, SearchSummary
from panoloc.core.results import Localization as Found
from panoloc.core.scan import reading
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.service.answer import Localization
from panoloc.service.cache import WorkerCache
from panoloc.service.errors import StorageFullError
from panoloc.service.jobs import LocalizeJob, MapRef, QueryImage, QueryOptions, RegisterJob, RegisterOptions
from panoloc.service.maps.record import MapRecord, Revision, key_of, read_record, write_record
from panoloc.service.settings import Settings
from panoloc.service.storage import FolderStorage
from panoloc.service.worker.localization_worker import LocalizationWorker
from panoloc.service.worker.map_catalog import store_index, stored_index
from panoloc.service.worker.plan import WorkerPlan, WorkerReply
from panoloc.service.worker.registrar import Registrar
from tests.core.scan.mesh_files import zip_of

MAP = MapRef("map_box", 1)
GREY = encode_png(np.full((128, 256, 3), 128, np.uint8))
OPTIONS = RegisterOptions(ScanOptions(unit="m", up_axis="z"), IndexOptions("grid", 2.0))


class MadeUpLocalizer:
    """Finds the first start of the first map, and remembers what it was asked."""

    device = torch.device("cpu")
    config = LocalizerConfig()

    def __init__(self) -> None:
        self.calls: list[dict[str, Any]] = []

    def localize(self, rig: Rig, maps: Sequence[MapIndex], **options: Any) -> Found:
        self.calls.append(options)
        best = Candidate(Pose(np.eye(3), maps[0].start_positions[0]), 0, 0.9, 1.0, 0.1, "none", 10)
        search = SearchSummary("fast", len(maps), 1, 1, 1)
        return Found("localized", search, {"search": 0.01}, best, (), 0.01, 0.1, 0.0, 0.0)


@dataclass
class Place:
    registrar: Registrar
    worker: LocalizationWorker
    cache: WorkerCache
    localizer: MadeUpLocalizer
    redis: "redis.Redis"
    storage: FolderStorage
    folder: Path
    job: RegisterJob

    def copies(self) -> list[Path]:
        """Return the copies of indexes in storage."""
        return list(self.folder.rglob("*.plmi"))


@pytest.fixture
def place(tmp_path: Path, redis_url: str) -> Iterator[Place]:
    torch.set_num_threads(1)
    storage = FolderStorage(tmp_path)
    settings = WorkerPlan.of(Settings(data_dir=tmp_path), redis_url)
    cache, localizer = WorkerCache(redis_url, index_lifetime_s=60), MadeUpLocalizer()
    worker = LocalizationWorker(settings, localizer, storage, cache)  # type: ignore[arg-type]
    with redis.Redis.from_url(redis_url) as client:
        job = store_box(storage)
        yield Place(Registrar(settings, storage, cache), worker, cache, localizer, client, storage, tmp_path, job)
    cache.close()


@pytest.fixture(scope="module")
def encoded() -> bytes:
    """Return the index of the box."""
    return encode_map_index(build_map_index(box(), OPTIONS.index))


@pytest.fixture
def registered(place: Place, encoded: bytes) -> Place:
    """Return a place with the index of the box in Redis and its copy in storage."""
    digest = index_config_digest(OPTIONS.index)
    place.cache.put_index(MAP, digest, encoded)
    store_index(place.storage, MAP, digest, encoded)
    return place


def box() -> PointCloud:
    """Return a coloured box of 4 x 4 x 2.5 m."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (20_000, 3)) * [2, 2, 1.25]
    side = rng.integers(0, 3, len(points))
    walls = np.sign(points) * [2, 2, 1.25]
    points[np.arange(len(points)), side] = walls[np.arange(len(points)), side]
    return PointCloud(points.astype(np.float32), (127 + 60 * np.sin(3 * points)).astype(np.uint8))


def store_box(storage: FolderStorage) -> RegisterJob:
    """Put the scan and the record of the box into storage."""
    scan = encode_ply(box())
    key, now = key_of(MAP, "scan.ply"), "2026-01-01T00:00:00Z"
    storage.put(key, scan)
    revision = Revision(1, key, "box.ply", len(scan), hashlib.sha256(scan).hexdigest(), OPTIONS)
    write_record(storage, MapRecord(MAP.id, "box", now, now, revision))
    return RegisterJob(MAP, key, "box.ply", OPTIONS, "req_1")


def query(panorama: bytes | None = None, seconds: float = 30, maps: tuple[MapRef, ...] = (MAP,)) -> LocalizeJob:
    options = QueryOptions(seconds, artifacts=("overlay",), top_k=3)
    return LocalizeJob(
        "loc_1", "req_2", (QueryImage(panorama or GREY),), maps, options, deadline_unix_s=time.time() + seconds
    )


@pytest.mark.slow
def test_a_registered_map_is_in_redis_and_describes_itself(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    # The scan is parsed in a sandbox, not in this process.
    monkeypatch.setattr(reading, "READERS", {})
    reply = place.registrar.register(place.job)
    assert reply.failure is None
    assert reply.outcome is not None
    stats = reply.outcome.stats
    assert json.loads(json.dumps(stats, allow_nan=False)) == stats
    assert stats["num_points"] == 20_000
    assert stats["bounds"]["max"] == pytest.approx([2, 2, 1.25], abs=0.01)
    assert stats["num_starts"] == len(reply.outcome.starts) > 0
    assert set(stats["seconds"]) == {"read", "starts", "render", "describe", "store"}
    (key,) = place.redis.keys("index:*")
    assert place.redis.strlen(key) == stats["index_bytes"]
    assert place.redis.ttl(key) > 0
    assert reply.outcome.preview_png.startswith(b"\x89PNG")
    assert reply.outcome.points_ply.startswith(b"ply\n")
    assert reply.outcome.diagnostics == []


@pytest.mark.slow
def test_a_map_whose_starts_lie_beside_the_scan_becomes_ready_with_diagnostics(place: Place) -> None:
    beside = replace(OPTIONS.index, region=((30.0, 30.0, 0.5), (32.0, 33.0, 1.5)))
    reply = place.registrar.register(replace(place.job, options=replace(OPTIONS, index=beside)))
    assert reply.outcome is not None
    found = [(each["code"], each["severity"]) for each in reply.outcome.diagnostics]
    assert found == [("starts_see_little", "warning"), ("region_outside_scan", "warning")]


def test_a_query_takes_the_index_from_redis_once_and_keeps_it(registered: Place) -> None:
    first, second = (registered.worker.localize(query(seconds=20)) for _ in range(2))
    assert (first.failure, second.failure) == (None, None)
    assert first.index_loads == {"redis": 1}
    assert second.index_loads == {"resident": 1}
    assert second.resident_bytes > 100_000
    assert first.outcome is not None
    answer = first.outcome.answer
    assert (answer.map_id, answer.map_revision) == (MAP.id, MAP.revision)
    assert list(first.outcome.pictures) == ["overlay"]
    assert answer.artifacts == {"overlay": "/localizations/loc_1/overlay.png"}
    assert {"load", "decode", "search", "pictures"} <= set(answer.timings_s)
    call = registered.localizer.calls[0]
    assert (call["method"], call["hints"], call["top_k"]) == ("fast", None, 3)
    assert 10 < call["timeout_s"] <= 20
    assert not call["is_cancelled"]()


def test_of_many_maps_few_are_loaded_and_the_vectors_of_all_are_kept(
    place: Place, encoded: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    maps = tuple(MapRef(f"map_{number}", 1) for number in range(20))
    digest = index_config_digest(OPTIONS.index)
    for each in maps:
        write_record(place.storage, replace(read_record(place.storage, MAP.id), id=each.id))
        store_index(place.storage, each, digest, encoded)
    first, second = (place.worker.localize(query(maps=maps)) for _ in range(2))
    assert (first.failure, first.index_loads) == (None, {"storage": 4})
    assert (second.failure, second.index_loads) == (None, {"resident": 4})
    assert first.outcome is not None
    assert first.outcome.answer.search["num_maps"] == 20
    assert first.outcome.answer.map_id in {each.id for each in maps}
    stored = sorted(place.folder.rglob("retrieval-*.npz"))
    assert len(stored) == 20
    scored = place.worker.localize(replace(query(maps=maps), share="share 0"))
    assert (len(scored.scores), len(set(scored.scores))) == (20, 1)  # all of them are of one box
    assert (scored.outcome, scored.failure, scored.index_loads, first.view) == (None, None, {}, b"")
    # Where others know the other maps of the query, they are shown what the map shows from there.
    found = place.worker.localize(replace(query(maps=maps[:9]), num_maps=90))
    assert Image.open(io.BytesIO(found.view)).size == (256, 128)
    pixels, files = np.asarray(Image.open(io.BytesIO(found.view))), []
    for columns in (0, 32):  # along the walls, and an eighth of a turn from there
        Image.fromarray(np.roll(pixels, columns, 1)).save(buffer := io.BytesIO(), "PNG")
        files.append(buffer.getvalue())
    shown = replace(query(maps=maps), share="share 0", along_walls=True)
    scored_views = [place.worker.localize(replace(shown, images=(QueryImage(file),))) for file in files]
    assert scored_views[0].scores[0] > 0.5
    assert scored_views[1].scores[0] < 0.8 * scored_views[0].scores[0]
    # Those that cannot be read are made again.
    key = key_of(maps[3], stored[3].name)
    before = place.storage.read(key)
    place.storage.put(key, b"PK")
    other = LocalizationWorker(place.worker._plan, place.localizer, place.storage, place.cache)  # type: ignore[arg-type]
    assert other.localize(query(maps=maps)).failure is None
    assert "retrieval vectors cannot be read" in caplog.text
    assert place.storage.read(key) == before


def test_maps_of_many_whose_index_is_missing_are_named(place: Place) -> None:
    maps = (MAP, *(MapRef(f"map_{number}", 1) for number in range(19)))
    for each in maps[1:]:
        write_record(place.storage, replace(read_record(place.storage, MAP.id), id=each.id))
    assert place.worker.localize(query(maps=maps)).missing == maps
    reply = place.worker.localize(query(maps=maps[:3]))
    assert reply.missing == maps[:3]
    assert reply.index_loads == {"missing": 3}


def test_an_outcome_is_the_same_after_it_has_travelled_to_another_process(registered: Place) -> None:
    outcome = registered.worker.localize(query()).outcome
    assert outcome is not None
    assert pickle.loads(pickle.dumps(outcome)) == outcome
    assert Localization.model_validate_json(outcome.answer.model_dump_json()) == outcome.answer


def test_an_index_that_redis_has_lost_comes_back_from_its_copy_without_being_built(registered: Place) -> None:
    (key,) = registered.redis.keys("index:*")
    before: Any = registered.redis.get(key)
    registered.redis.flushall()
    reply = registered.worker.localize(query())
    assert (reply.failure, reply.missing, reply.index_loads) == (None, (), {"storage": 1})
    assert registered.redis.get(key) == before


@pytest.mark.slow
def test_a_full_disk_stops_no_registration(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise StorageFullError("the disk is full")

    monkeypatch.setattr(FolderStorage, "put", full)
    assert place.registrar.register(place.job).failure is None
    assert place.copies() == []
    place.redis.flushall()
    assert place.worker.localize(query()).missing == (MAP,)


@pytest.mark.slow
def test_an_index_that_is_lost_or_damaged_with_its_copy_is_reported_and_can_be_built_again(registered: Place) -> None:
    for copy in registered.copies():
        copy.write_bytes(copy.read_bytes()[:-100])
    (key,) = registered.redis.keys("index:*")
    kept: Any = registered.redis.get(key)
    for damaged in (kept[: len(kept) // 2], b"", kept[:4] + b"\xff\xff" + kept[6:], b"something else", None):
        registered.redis.delete(key)
        if damaged is not None:
            registered.redis.set(key, damaged, ex=60)
        reply = registered.worker.localize(query())
        assert (reply.outcome, reply.failure, reply.missing) == (None, None, (MAP,))
    assert registered.registrar.rebuild(MAP).failure is None
    assert registered.worker.localize(query()).outcome is not None


@pytest.mark.slow
@pytest.mark.parametrize("way", ["register", "rebuild"])
def test_an_index_whose_map_was_deleted_while_it_was_built_is_not_kept(
    place: Place, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    put = WorkerCache.put_index

    def put_too_late(cache: WorkerCache, ref: MapRef, digest: str, data: bytes) -> None:
        place.storage.delete_all(f"maps/{ref.id}")
        put(cache, ref, digest, data)

    monkeypatch.setattr(WorkerCache, "put_index", put_too_late)
    reply = place.registrar.register(place.job) if way == "register" else place.registrar.rebuild(MAP)
    assert kind_of(reply) == "MapNotFoundError"
    assert place.redis.keys("index:*") == []
    assert place.copies() == []


def test_a_query_past_its_deadline_is_not_begun(place: Place) -> None:
    assert kind_of(place.worker.localize(query(seconds=-1))) == "DeadlineExceededError"
    assert place.localizer.calls == []


def test_a_query_that_cannot_be_answered_fails_by_the_name_of_its_error(registered: Place) -> None:
    assert kind_of(registered.worker.localize(query(panorama=b"this is text"))) == "PanoramaFormatError"
    # Whoever builds its index again finds out that a map is gone.
    gone = MapRef("map_gone", 1)
    assert registered.worker.localize(query(maps=(gone, MAP))).missing == (gone,)
    assert kind_of(registered.registrar.rebuild(gone)) == "MapNotFoundError"


def kind_of(reply: WorkerReply[Any]) -> str | None:
    """Return the name of the error that a worker replied."""
    return None if reply.failure is None else reply.failure.kind


def test_a_scan_that_changed_on_disk_is_not_registered(place: Place, tmp_path: Path) -> None:
    (tmp_path / place.job.scan_key).write_bytes(b"ply\n")
    assert kind_of(place.registrar.register(place.job)) == "StoredFileDamagedError"


def test_the_next_registration_removes_the_unpacked_archive_of_a_killed_one(place: Place, tmp_path: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    remains = tmp_path / "uploads" / f"panoloc-zip-{socket.gethostname()}-{gone.pid}-x"
    own = tmp_path / "uploads" / f"panoloc-zip-{socket.gethostname()}-{os.getpid()}-x"
    for folder in (remains, own):
        (folder / "scans").mkdir(parents=True)
    few_points(place)
    place.registrar.register(place.job)
    assert (remains.exists(), own.exists()) == (False, True)


def few_points(place: Place) -> None:
    """Replace the scan by one of too few points."""
    points = np.random.default_rng(0).uniform(-1, 1, (MIN_POINTS - 1, 3)).astype(np.float32)
    place.storage.put(place.job.scan_key, encode_ply(PointCloud(points, np.full((len(points), 3), 99, np.uint8))))


def test_a_scan_of_a_handful_of_points_is_no_map(place: Place) -> None:
    few_points(place)
    failure = place.registrar.register(place.job).failure
    assert failure is not None
    assert failure.kind == "ScanContentError"
    assert f"expected at least {MIN_POINTS}" in failure.message
    assert "got 99" in failure.message


def test_a_copy_of_an_index_replaces_those_of_other_configurations(place: Place) -> None:
    for digest in ("0123", "4567"):
        store_index(place.storage, MAP, digest, digest.encode())
    assert stored_index(place.storage, MAP, "4567") == b"4567"
    assert stored_index(place.storage, MAP, "0123") is None
    assert len(place.copies()) == 1


@pytest.mark.slow
def test_a_zip_is_unpacked_on_the_disk_of_the_scans(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    place.storage.put(key_of(MAP, "scan.zip"), zip_of({"box.ply": place.storage.read(place.job.scan_key)}))
    monkeypatch.setattr("tempfile.tempdir", "/no such folder")
    job = replace(place.job, scan_key=key_of(MAP, "scan.zip"), scan_name="box.zip")
    assert place.registrar.register(job).failure is None
    assert place.storage.names("uploads") == []


@pytest.mark.parametrize("lack", [MemoryError(), RuntimeError("DefaultCPUAllocator: can't allocate memory: 9 bytes")])
def test_a_scan_that_needs_too_much_memory_fails_with_the_limit_that_it_met(
    place: Place, monkeypatch: pytest.MonkeyPatch, lack: Exception
) -> None:
    def read(*_: object) -> None:
        raise lack

    monkeypatch.setattr("panoloc.service.worker.registrar.read_scan", read)
    failure = place.registrar.register(place.job).failure
    assert failure is not None
    assert failure.kind == "RegistrationLimitError"
    assert "PANOLOC_REGISTRATION_MEMORY_BYTES" in failure.message


def test_the_limits_of_the_process_grow_with_the_scan(place: Place) -> None:
    given: list[tuple[int, float]] = []
    settings = WorkerPlan.of(Settings(registration_memory_bytes=2**28), "redis://")
    few_points(place)
    Registrar(settings, place.storage, place.cache, lambda *limits: given.append(limits)).register(place.job)
    scan_bytes = len(place.storage.read(place.job.scan_key))
    ((num_bytes, cpu_s),) = given
    assert num_bytes == 2**28 + 8 * scan_bytes
    assert cpu_s >= settings.registration_limits.seconds(scan_bytes)
