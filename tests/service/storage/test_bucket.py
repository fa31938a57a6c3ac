"""What is peculiar to a bucket: steps of a deletion, copies on this disk, and buckets that are away, full or closed."""

import fcntl
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import obstore
import pytest

from panoloc.service.errors import (
    StorageAwayError,
    StorageFullError,
    StorageReadOnlyError,
    StoredFileDamagedError,
    StoredFileMissingError,
)
from panoloc.service.storage import BucketAccess, open_storage
from panoloc.service.storage.bucket import BucketStorage
from panoloc.service.storage.bucket_client import open_client
from panoloc.service.storage.bucket_objects import BucketObjects, bucket_errors
from panoloc.service.storage.claim import BucketUnusableError, check_bucket
from tests.service.storage.bucket_server import BUCKET, BucketServer


def keys_in(server: BucketServer, prefix: str) -> list[str]:
    """Return all that is in the bucket below a prefix, in order."""
    pages: Any = obstore.list(server.client(prefix))
    return sorted(each["path"] for page in pages for each in page)


class InterruptedDeletionError(BaseException):
    """The process is gone."""


MAP = ("maps/m/map.json", "maps/m/1/scan.ply", "maps/m/1/points.ply")


@pytest.fixture
def interrupt_deletion(bucket: BucketStorage, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Store a map, and delete it until the process ends at its nth request to delete."""

    def interrupt(step: int) -> None:
        num_calls, really_delete = 0, obstore.delete

        def delete(*arguments: Any) -> None:
            nonlocal num_calls
            if num_calls == step:
                raise InterruptedDeletionError
            num_calls += 1
            really_delete(*arguments)

        for key in MAP:
            bucket.put(key, b"x")
        with monkeypatch.context() as patch:
            patch.setattr(obstore, "delete", delete)
            with pytest.raises(InterruptedDeletionError):
                bucket.delete_all("maps/m")

    return interrupt


Interrupt = Callable[[int], None]


@pytest.mark.parametrize("step", [1, 2])
def test_a_deletion_that_is_interrupted_leaves_no_map_and_is_finished_at_the_next_start(
    bucket: BucketStorage, bucket_server: BucketServer, prefix: str, interrupt_deletion: Interrupt, step: int
) -> None:
    bucket.put("maps/other/map.json", b"x")
    interrupt_deletion(step)
    with pytest.raises(StoredFileMissingError):
        bucket.read("maps/m/map.json")
    assert sorted(bucket.stamps("maps", "map.json")) == ["other"]
    bucket.tidy(24 * 3600.0)
    assert keys_in(bucket_server, prefix) == ["maps/other/map.json"]


def test_a_deletion_that_did_not_come_to_its_first_step_deletes_nothing_later(
    bucket: BucketStorage, bucket_server: BucketServer, prefix: str, interrupt_deletion: Interrupt
) -> None:
    interrupt_deletion(0)
    notes = bucket.names("deleted")
    bucket.tidy(24 * 3600.0)  # of a process that may just be at it
    assert bucket.names("deleted") == notes
    bucket.tidy()
    assert keys_in(bucket_server, prefix) == sorted(MAP)


@pytest.mark.slow
def test_what_was_stored_after_a_deletion_is_not_deleted_with_it(
    bucket: BucketStorage, bucket_server: BucketServer, prefix: str, interrupt_deletion: Interrupt
) -> None:
    interrupt_deletion(1)
    time.sleep(1.1)  # times of objects have no fractions
    bucket.put("maps/m/1/scan.ply", b"another")
    bucket.tidy()
    assert keys_in(bucket_server, prefix) == ["maps/m/1/scan.ply"]


def test_a_deletion_whose_second_step_is_refused_is_one_all_the_same(
    bucket: BucketStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    for key in MAP:
        bucket.put(key, b"x")
    really_delete = obstore.delete

    def delete(client: Any, paths: Any) -> None:
        if paths == "maps/m/map.json":
            really_delete(client, paths)
        else:
            raise obstore.exceptions.GenericError("away")

    with monkeypatch.context() as patch:
        patch.setattr(obstore, "delete", delete)
        bucket.delete_all("maps/m")
    assert bucket.stamps("maps", "map.json") == {}
    bucket.tidy()
    assert bucket.names("maps") == []
    assert bucket.names("deleted") == []


@pytest.mark.parametrize("note", [b"", b"[]", b"{", b'{"prefix": "maps"}'])
def test_a_note_that_cannot_be_read_deletes_nothing(bucket: BucketStorage, note: bytes) -> None:
    bucket.put("maps/m/map.json", b"x")
    bucket.put("deleted/a.json", note)
    bucket.tidy()
    assert bucket.names("maps") == ["m"]


def test_a_folder_can_be_copied_into_a_bucket_with_its_digests(
    bucket: BucketStorage, bucket_server: BucketServer, prefix: str
) -> None:
    client = bucket_server.client(prefix)
    digest = "4ba2cdb37a8ebf2a7ee1c37a9d1ba8e2bd3f7a8c5b7e0a9c5b9c7d7f7e6c2b9d"
    obstore.put(client, "maps/m/1/scan.ply", b"a scan")
    assert bucket.read("maps/m/1/scan.ply") == b"a scan"
    obstore.put(client, "maps/m/1/scan.ply.sha256", digest.encode() + b"\n")
    assert bucket.names("maps/m/1") == ["scan.ply"]
    with pytest.raises(StoredFileDamagedError):
        bucket.read("maps/m/1/scan.ply")
    with pytest.raises(StoredFileDamagedError), bucket.local_copy("maps/m/1/scan.ply"):
        pass
    bucket.delete("maps/m/1/scan.ply")
    assert keys_in(bucket_server, prefix) == []


def test_the_list_of_many_files_is_left_as_soon_as_the_record_is_seen(
    bucket: BucketStorage, bucket_server: BucketServer, prefix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.service.storage.bucket._PAGE", 5)
    client = bucket_server.client(prefix)
    for batch in ("a", "b", "ba", "c"):
        for key in ("batch.json", *(f"images/{number:05}" for number in range(14)), "adjacent"):
            obstore.put(client, f"batches/{batch}/{key}", b"x")
    obstore.put(client, "batches/d/zzz", b"without a record")
    for number in range(7):
        obstore.put(client, f"batches/ba/a{number}", b"before the record")
    num_pages = 0
    really_list = obstore.list

    def counting(*arguments: Any, **named: Any) -> Any:
        nonlocal num_pages
        num_pages += 1
        return really_list(*arguments, **named)

    monkeypatch.setattr(obstore, "list", counting)
    assert sorted(bucket.stamps("batches", "batch.json")) == ["a", "b", "ba", "c"]
    assert num_pages <= 8  # all of them would take 15


# Copies on this disk.


def copies_in(folder: Path) -> list[Path]:
    """Return the copies that are kept."""
    return sorted((folder / "copies").iterdir())


def test_a_copy_is_fetched_once_and_again_when_it_was_replaced(
    bucket: BucketStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched: list[str] = []
    really_fetch = BucketObjects.pieces

    def fetch(self: BucketObjects, found: Any) -> Iterator[bytes]:
        fetched.append(found.key)
        return really_fetch(self, found)

    monkeypatch.setattr(BucketObjects, "pieces", fetch)
    bucket.put("maps/m/1/points.ply", b"first")
    fetched.clear()
    for _ in range(3):
        with bucket.local_copy("maps/m/1/points.ply") as path, bucket.local_copy("maps/m/1/points.ply") as again:
            assert path.read_bytes() == again.read_bytes() == b"first"
    bucket.put("maps/m/1/points.ply", b"second")
    with bucket.local_copy("maps/m/1/points.ply") as path:
        assert path.read_bytes() == b"second"
    assert len(fetched) == 2
    assert len(copies_in(tmp_path / "machine")) == 2


def test_a_copy_that_changed_on_this_disk_is_fetched_anew(bucket: BucketStorage, tmp_path: Path) -> None:
    bucket.put("maps/m/1/points.ply", b"points")
    with bucket.local_copy("maps/m/1/points.ply"):
        pass
    (copy,) = copies_in(tmp_path / "machine")
    copy.write_bytes(b"pointz")
    with bucket.local_copy("maps/m/1/points.ply") as path:
        assert path.read_bytes() == b"points"


def test_copies_take_no_more_room_than_allowed_and_those_used_last_stay(
    bucket_server: BucketServer, prefix: str, tmp_path: Path
) -> None:
    storage = bucket_server.storage(tmp_path, prefix, copies_bytes=2500)
    for name in ("a", "b", "c", "too-large"):
        storage.put(name, name.encode() * 1000)
    for name in ("a", "b", "a", "c", "too-large"):
        with storage.local_copy(name) as path:
            assert path.read_bytes() == name.encode() * 1000
        time.sleep(0.02)  # times of files are coarse
    assert sorted(copy.read_bytes()[:1] for copy in copies_in(tmp_path)) == [b"a", b"c"]


def test_a_copy_stays_while_any_process_uses_it_and_nothing_does_afterwards(
    bucket_server: BucketServer, prefix: str, tmp_path: Path
) -> None:
    storage, other = (bucket_server.storage(tmp_path, prefix, copies_bytes=0) for _ in range(2))
    storage.put("a", b"a")
    with storage.local_copy("a") as path:
        with other.local_copy("a"):
            pass
        assert path.read_bytes() == b"a"
    assert copies_in(tmp_path) == []


def test_many_that_fetch_the_same_file_at_once_all_read_it(
    bucket_server: BucketServer, prefix: str, tmp_path: Path
) -> None:
    storage = bucket_server.storage(tmp_path, prefix, copies_bytes=0)
    storage.put("a", b"a" * 1000)

    def read(_: int) -> bytes:
        with storage.local_copy("a") as path:
            return path.read_bytes()

    with ThreadPoolExecutor(8) as threads:
        assert set(threads.map(read, range(40))) == {b"a" * 1000}
    assert copies_in(tmp_path) == []


def test_what_a_killed_process_was_fetching_is_removed_and_not_what_another_fetches(
    bucket: BucketStorage, tmp_path: Path
) -> None:
    (folder := tmp_path / "machine" / "copies").mkdir(parents=True)
    for name in (".dead", ".fetching"):
        (folder / name).write_bytes(b"half")
    bucket.put("a", b"a")
    with (folder / ".fetching").open() as fetching:
        fcntl.flock(fetching, fcntl.LOCK_SH)
        with bucket.local_copy("a"):
            pass
        assert sorted(path.name for path in copies_in(tmp_path / "machine"))[0] == ".fetching"
        assert not (folder / ".dead").exists()


# Buckets that do not serve.


@pytest.mark.slow
def test_a_bucket_that_goes_away_is_reported_within_seconds_and_serves_again(
    bucket: BucketStorage, bucket_server: BucketServer
) -> None:
    bucket.put("a", b"x")
    bucket.check_writable()
    upload = bucket.spool_folder() / "upload"
    upload.write_bytes(b"kept")
    with bucket_server.away():
        for call in (
            lambda: bucket.read("a"),
            lambda: bucket.adopt("b", upload, "0"),
            lambda: bucket.stamps("maps", "map.json"),
        ):
            began = time.monotonic()
            with pytest.raises(StorageAwayError, match="expected an answer from the bucket s3://scans/"):
                call()
            assert time.monotonic() - began < 20
        assert upload.read_bytes() == b"kept"
    bucket.put("a", b"z")
    assert bucket.read("a") == b"z"


@pytest.mark.slow
def test_readiness_learns_within_seconds_that_a_bucket_hangs(
    bucket_server: BucketServer, prefix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.service.storage.bucket._PROBE_LASTS_S", 0.0)
    monkeypatch.setattr("panoloc.service.storage.bucket_client._PROBE_TIMEOUT_S", 1.0)
    bucket = bucket_server.storage(tmp_path, prefix)
    bucket.check_writable()
    bucket_server.pause()
    began = time.monotonic()
    try:
        with pytest.raises(StorageAwayError):
            bucket.check_writable()
    finally:
        bucket_server.go_on()
    assert time.monotonic() - began < 10
    bucket.check_writable()


def test_a_key_that_opens_nothing_is_reported_before_the_service_starts(
    bucket: BucketStorage, bucket_server: BucketServer, prefix: str
) -> None:
    check_bucket(bucket, is_shared=True)
    assert keys_in(bucket_server, prefix) == []
    with bucket_server.refusing():
        with pytest.raises(
            StorageReadOnlyError, match=r"can be written, got InvalidAccessKeyId .*the key and its rights"
        ):
            bucket.put("a", b"x")
        with pytest.raises(StorageAwayError, match="can be read, got InvalidAccessKeyId"):
            bucket.read("a")
        with pytest.raises(BucketUnusableError, match="the key and its rights") as found:
            check_bucket(bucket, is_shared=False)
    assert "\n" not in str(found.value)
    assert "a-secret" not in str(found.value)


def test_a_bucket_that_does_not_exist_is_reported_before_the_service_starts(
    bucket_server: BucketServer, tmp_path: Path
) -> None:
    access = BucketAccess(str(tmp_path), 0, bucket_server.variables)
    storage = BucketStorage("s3://no-such-bucket", access)
    with pytest.raises(BucketUnusableError, match=r"NoSuchBucket.*correct PANOLOC_STORAGE"):
        check_bucket(storage, is_shared=False)
    with pytest.raises(StorageAwayError):
        storage.read("a")


def test_a_bucket_that_takes_writes_over_what_has_changed_serves_no_several_api_replicas(
    bucket: BucketStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace = BucketStorage.replace
    monkeypatch.setattr(BucketStorage, "replace", lambda self, key, data, over=None: replace(self, key, data))
    check_bucket(bucket, is_shared=False)
    with pytest.raises(BucketUnusableError, match=r"If-Match.*without PANOLOC_SHARED"):
        check_bucket(bucket, is_shared=True)


@pytest.mark.parametrize(
    "answer",
    [
        "Server returned non-2xx status code: 507 Insufficient Storage",
        "Server returned non-2xx status code: 400 Bad Request: <Error><Code>XMinioStorageFull</Code></Error>",
    ],
)
def test_a_full_bucket_is_reported(answer: str) -> None:
    with (
        pytest.raises(StorageFullError, match="expected room in the bucket s3://b"),
        bucket_errors("s3://b", "key", writes=True),
    ):
        raise obstore.exceptions.GenericError(answer)


# URLs and variables.


def test_a_storage_is_named_by_a_url(tmp_path: Path, bucket_server: BucketServer, prefix: str) -> None:
    access = BucketAccess(str(tmp_path), 0, bucket_server.variables)
    open_storage(f"s3://{BUCKET}/{prefix}/deeper/", access).put("key", b"x")
    assert keys_in(bucket_server, prefix) == ["deeper/key"]
    for url in ("http://bucket", "s3://", "file://relative", "s3:///prefix"):
        with pytest.raises(ValueError, match="expected s3://bucket/prefix"):
            open_storage(url, access)
    with pytest.raises(ValueError, match="expected no key in the URL"):
        open_storage("s3://id:secret@bucket", access)


@pytest.mark.parametrize(
    ("url", "variables"),
    [
        ("gs://bucket/prefix", {"GOOGLE_SKIP_SIGNATURE": "true"}),
        ("az://container/prefix", {"AZURE_STORAGE_ACCOUNT_NAME": "account", "AZURE_STORAGE_ACCOUNT_KEY": "YQ=="}),
    ],
)
def test_buckets_of_other_kinds_are_opened_by_variables_of_their_own(
    url: str, variables: dict[str, str], tmp_path: Path
) -> None:
    assert isinstance(open_storage(url, BucketAccess(str(tmp_path), 0, variables)), BucketStorage)
    assert str(getattr(open_client(url, variables), "prefix", None)) == "prefix"


def test_variables_of_other_tools_do_no_harm_and_wrong_ones_are_reported(
    bucket_server: BucketServer, tmp_path: Path
) -> None:
    extra = {"AWS_PROFILE": "x", "AWS_PAGER": "", "AWS_BUCKET": "other", "AWS_MAX_ATTEMPTS": "3"}
    access = BucketAccess(str(tmp_path), 0, bucket_server.variables | extra)
    open_storage(f"s3://{BUCKET}", access).put("variables", b"x")
    with pytest.raises(StorageAwayError, match="expected variables for the access to az://container"):
        open_storage("az://container", BucketAccess(str(tmp_path), 0, {}))
    assert "a-secret" not in repr(access)
    assert os.environ.get("AWS_SECRET_ACCESS_KEY") is None
