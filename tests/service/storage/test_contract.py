"""What every storage promises, asked of a folder and of a bucket."""

import hashlib
import threading
from pathlib import Path

import pytest

from panoloc.service.errors import StoredFileChangedError, StoredFileDamagedError, StoredFileMissingError
from panoloc.service.storage import FolderStorage, Storage
from tests.service.storage.bucket_server import BucketServer


class Place:
    """A storage, and access to its files that bypasses it."""

    def __init__(self, kind: str, folder: Path, server: BucketServer, prefix: str) -> None:
        self._folder, self._server, self._prefix = folder, server, prefix
        self._kind = kind
        self.storage: Storage = FolderStorage(folder) if kind == "folder" else server.storage(folder, prefix)

    def damage(self, key: str, data: bytes) -> None:
        """Change stored bytes without the storage."""
        if self._kind == "folder":
            (self._folder / key).write_bytes(data)
        else:
            self._server.overwrite(self._prefix, key, data)

    def elsewhere(self, folder: Path) -> Storage:
        """Return the storage as another process sees it."""
        return FolderStorage(self._folder) if self._kind == "folder" else self._server.storage(folder, self._prefix)


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path, bucket_server: BucketServer, prefix: str) -> Place:
    return Place(request.param, tmp_path / "data", bucket_server, prefix)


@pytest.fixture
def storage(place: Place) -> Storage:
    return place.storage


def adopted(storage: Storage, key: str, data: bytes) -> None:
    upload = storage.spool_folder() / "upload"
    upload.write_bytes(data)
    storage.adopt(key, upload, hashlib.sha256(data).hexdigest())
    assert not upload.exists()


def copied(storage: Storage, key: str, checked: bool = True) -> bytes:
    with storage.local_copy(key, checked=checked) as path:
        return path.read_bytes()


@pytest.mark.parametrize("data", [b"two", b"", bytes(range(256)) * 50_000], ids=["short", "empty", "of several pieces"])
def test_what_is_put_is_read_back_also_elsewhere(place: Place, tmp_path: Path, data: bytes) -> None:
    place.storage.put("maps/m/1/preview.png", b"one")
    place.storage.put("maps/m/1/preview.png", data)
    for each in (place.storage, place.elsewhere(tmp_path / "other")):
        assert each.read("maps/m/1/preview.png") == data
        assert copied(each, "maps/m/1/preview.png") == data
        assert copied(each, "maps/m/1/preview.png", checked=False) == data


def test_an_upload_is_moved_in_with_its_digest(storage: Storage) -> None:
    scan = bytes(range(256)) * 100_000
    adopted(storage, "maps/m/1/scan.ply", scan)
    assert storage.read("maps/m/1/scan.ply") == scan
    with storage.local_copy("maps/m/1/scan.ply") as path:
        assert path.suffix == ".ply"
        assert path.read_bytes() == scan


@pytest.mark.parametrize("way", ["read", "local_copy"])
@pytest.mark.parametrize("written", ["put", "adopt"])
def test_a_file_that_was_changed_by_hand_is_not_used(place: Place, way: str, written: str) -> None:
    if written == "put":
        place.storage.put("maps/m/1/scan.ply", b"a scan")
    else:
        adopted(place.storage, "maps/m/1/scan.ply", b"a scan")
    place.damage("maps/m/1/scan.ply", b"a scam")
    for _ in range(2):
        with pytest.raises(StoredFileDamagedError, match="expected the SHA-256"):
            place.storage.read("maps/m/1/scan.ply") if way == "read" else copied(place.storage, "maps/m/1/scan.ply")
    assert copied(place.storage, "maps/m/1/scan.ply", checked=False) == b"a scam"


@pytest.mark.parametrize("way", ["read", "local_copy", "read_stamped"])
def test_a_file_that_is_not_there_is_missing(storage: Storage, way: str) -> None:
    with pytest.raises(StoredFileMissingError, match="maps/none"):
        copied(storage, "maps/none") if way == "local_copy" else getattr(storage, way)("maps/none")


def test_names_are_those_directly_below(storage: Storage) -> None:
    assert storage.names("maps") == []
    for key in ("maps/b/map.json", "maps/a/map.json", "maps/a/1/scan.ply", "maps/ab/map.json", "other"):
        storage.put(key, b"x")
    assert storage.names("maps") == ["a", "ab", "b"]
    assert storage.names("maps/a") == ["1", "map.json"]
    assert storage.names("maps/a/1") == ["scan.ply"]
    assert storage.names("map") == []


def test_deleting_takes_everything_below_and_nothing_beside(storage: Storage) -> None:
    for key in ("maps/m/map.json", "maps/m/1/scan.ply", "maps/m/1/a/b", "maps/mm/map.json"):
        storage.put(key, b"x")
    storage.delete_all("maps/m")
    storage.delete_all("maps/m")
    assert storage.names("maps") == ["mm"]
    for key in ("maps/m/map.json", "maps/m/1/scan.ply", "maps/m/1/a/b"):
        with pytest.raises(StoredFileMissingError):
            storage.read(key)


def test_one_file_is_deleted_alone(storage: Storage) -> None:
    storage.put("maps/m/1/index-a.plmi", b"a")
    storage.put("maps/m/1/index-b.plmi", b"b")
    storage.delete("maps/m/1/index-a.plmi")
    storage.delete("maps/m/1/index-a.plmi")
    assert storage.names("maps/m/1") == ["index-b.plmi"]


def test_stamps_tell_what_was_replaced_since(storage: Storage) -> None:
    for each in ("a", "b"):
        storage.replace(f"maps/{each}/map.json", b"first")
        storage.put(f"maps/{each}/1/map.json", b"not directly below")
    storage.put("maps/c/other.json", b"x")
    before = storage.stamps("maps", "map.json")
    assert sorted(before) == ["a", "b"]
    assert storage.read_stamped("maps/a/map.json") == (b"first", before["a"])
    assert storage.replace("maps/a/map.json", b"second") == storage.stamps("maps", "map.json")["a"]
    after = storage.stamps("maps", "map.json")
    assert after["a"] != before["a"]
    assert after["b"] == before["b"]
    storage.delete_all("maps/b")
    assert sorted(storage.stamps("maps", "map.json")) == ["a"]
    assert storage.stamps("batches", "batch.json") == {}


def test_of_two_writes_over_the_same_version_the_second_is_refused(storage: Storage) -> None:
    storage.replace("maps/a/map.json", b"first")
    _, stamp = storage.read_stamped("maps/a/map.json")
    newer = storage.replace("maps/a/map.json", b"second!", stamp)
    with pytest.raises(StoredFileChangedError):
        storage.replace("maps/a/map.json", b"third", stamp)
    assert storage.read_stamped("maps/a/map.json") == (b"second!", newer)


def test_what_was_deleted_is_not_written_over(storage: Storage) -> None:
    stamp = storage.replace("maps/a/map.json", b"first")
    storage.delete_all("maps/a")
    with pytest.raises(StoredFileChangedError):
        storage.replace("maps/a/map.json", b"second", stamp)
    assert storage.names("maps") == []


@pytest.mark.parametrize("key", ["../x", "maps/../../x", "/etc/passwd", "", "a//b", "a/\0", "a\\..\\b", "."])
def test_a_key_never_leads_elsewhere(storage: Storage, key: str) -> None:
    for call in (storage.read, storage.names, storage.delete_all, storage.delete):
        with pytest.raises(StoredFileMissingError, match="expected a key such as"):
            call(key)
    with pytest.raises(StoredFileMissingError, match="expected a key such as"):
        storage.put(key, b"x")
    with pytest.raises(StoredFileMissingError, match="expected a key such as"):
        copied(storage, key)


def test_a_storage_that_can_be_written_passes_the_check(storage: Storage) -> None:
    storage.check_writable()
    storage.check_writable()
    assert list(storage.spool_folder().iterdir()) == []


def test_tidying_removes_uploads_and_nothing_else(storage: Storage) -> None:
    storage.put("maps/m/1/scan.ply", b"a scan")
    (storage.spool_folder() / "half").write_bytes(b"half")
    storage.tidy(3600.0)
    assert [each.name for each in storage.spool_folder().iterdir()] == ["half"]
    storage.tidy()
    assert list(storage.spool_folder().iterdir()) == []
    assert storage.read("maps/m/1/scan.ply") == b"a scan"


def test_many_threads_read_and_write_at_the_same_time(storage: Storage) -> None:
    faults: list[BaseException] = []

    def work(number: int) -> None:
        try:
            for again in range(3):
                key = f"batches/b/results/{number:05}.json"
                storage.replace(key, f"{number} {again}".encode())
                assert storage.read(key) == copied(storage, key) == f"{number} {again}".encode()
        except BaseException as error:
            faults.append(error)

    threads = [threading.Thread(target=work, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert faults == []
    assert len(storage.names("batches/b/results")) == 8
