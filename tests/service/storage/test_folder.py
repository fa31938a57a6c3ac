"""Files survive crashes and full disks whole; what every storage promises is in `test_contract`."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from panoloc.service.errors import StorageError, StorageFullError, StorageReadOnlyError, StoredFileMissingError
from panoloc.service.storage import FolderStorage, open_storage


@pytest.fixture
def storage(tmp_path: Path) -> FolderStorage:
    return FolderStorage(tmp_path)


@pytest.mark.parametrize("read", [lambda storage: storage.read_stamped("a/b"), lambda storage: storage.names("a")])
def test_what_belongs_to_another_user_is_named(
    storage: FolderStorage, monkeypatch: pytest.MonkeyPatch, read: Callable[[FolderStorage], object]
) -> None:
    storage.put("a/b", b"data")
    for module, name in ((Path, "open"), (os, "listdir")):
        monkeypatch.setattr(module, name, raising(PermissionError(13, "Permission denied")))
    with pytest.raises(StorageError, match=r"'a(/b)?': .*Permission denied; give it to the user of the service"):
        read(storage)


class PowerCutError(BaseException):
    """The process is gone."""


def raising(error: BaseException) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


FULL = OSError(28, "No space left on device")


def adopt(storage: FolderStorage, key: str, data: bytes) -> None:
    upload = storage.spool_folder() / "upload"
    upload.write_bytes(data)
    storage.adopt(key, upload, hashlib.sha256(data).hexdigest())


WAYS: list[Callable[[FolderStorage, str, bytes], object]] = [FolderStorage.put, adopt, FolderStorage.replace]


@pytest.mark.parametrize("moment", ["fsync", "replace"])
def test_a_crash_while_writing_leaves_the_old_bytes(
    storage: FolderStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    storage.replace("maps/m/map.json", b"old")
    with monkeypatch.context() as patch:
        patch.setattr(os if moment == "fsync" else Path, moment, raising(PowerCutError()))
        # Nothing of ours runs any more once the process is gone.
        patch.setattr(Path, "unlink", lambda *_, **__: None)
        with pytest.raises(PowerCutError):
            storage.replace("maps/m/map.json", b"new")
    assert storage.read("maps/m/map.json") == b"old"
    assert storage.names("maps/m") == ["map.json"]
    storage.tidy()
    assert [entry.name for entry in (tmp_path / "maps" / "m").iterdir()] == ["map.json"]


@pytest.mark.parametrize("write", WAYS)
def test_what_was_stored_or_deleted_survives_a_power_cut(
    storage: FolderStorage,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    write: Callable[[FolderStorage, str, bytes], object],
) -> None:
    """The disk holds the bytes of a file and the entries of a folder as they were when it was last synced."""
    on_disk: dict[int, object] = {}
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        path = Path(os.readlink(f"/proc/self/fd/{descriptor}"))
        is_folder = path.is_dir()
        on_disk[path.stat().st_ino] = {each.name for each in path.iterdir()} if is_folder else path.read_bytes()
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    write(storage, "maps/m/1/scan.ply", b"a scan")
    for path in [tmp_path / "maps", *(tmp_path / "maps").rglob("*")]:
        if path.is_file():
            assert on_disk[path.stat().st_ino] == path.read_bytes()
        entries = on_disk[path.parent.stat().st_ino]
        assert isinstance(entries, set)
        assert path.name in entries
    storage.delete_all("maps/m")
    assert on_disk[(tmp_path / "maps").stat().st_ino] == set()


@pytest.mark.parametrize("write", WAYS[:2])
def test_no_crash_leaves_a_file_that_nothing_would_check(
    storage: FolderStorage, monkeypatch: pytest.MonkeyPatch, write: Callable[[FolderStorage, str, bytes], object]
) -> None:
    num_renamed = 0
    replace = Path.replace

    def cut_after_the_first(self: Path, target: Path) -> Path:
        nonlocal num_renamed
        num_renamed += 1
        if num_renamed > 1:
            raise PowerCutError
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", cut_after_the_first)
        with pytest.raises(PowerCutError):
            write(storage, "maps/m/1/scan.ply", b"a scan")
    with pytest.raises(StoredFileMissingError):
        storage.read("maps/m/1/scan.ply")


def test_a_write_to_a_full_disk_leaves_nothing_behind(
    storage: FolderStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", raising(FULL))
    with pytest.raises(StorageFullError, match="the disk is full"):
        storage.replace("map.json", b"data")
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_cannot_begin_raises_the_systems_error(storage: FolderStorage, tmp_path: Path) -> None:
    (tmp_path / "map.json").mkdir()
    with pytest.raises(OSError, match="File name too long"):
        storage.replace("a" * 250, b"data")
    with pytest.raises(IsADirectoryError):
        storage.replace("map.json", b"data")
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.json"]


@pytest.mark.parametrize(
    ("number", "raised"), [(28, StorageFullError), (30, StorageReadOnlyError), (13, StorageReadOnlyError)]
)
def test_readiness_learns_that_the_disk_takes_nothing(
    storage: FolderStorage, monkeypatch: pytest.MonkeyPatch, number: int, raised: type[Exception]
) -> None:
    storage.check_writable()
    monkeypatch.setattr(Path, "write_bytes", raising(OSError(number, os.strerror(number))))
    with pytest.raises(raised):
        storage.check_writable()
    assert list(storage.spool_folder().iterdir()) == []


def test_a_map_can_be_deleted_from_a_disk_without_room_for_a_folder(
    storage: FolderStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage.put("maps/m/map.json", b"record")
    monkeypatch.setattr(Path, "mkdir", raising(FULL))
    storage.delete_all("maps/m")
    assert storage.names("maps") == []
    assert [entry.name for entry in tmp_path.iterdir()] == ["maps"]


def test_tidying_removes_what_a_crash_left_and_nothing_else(storage: FolderStorage, tmp_path: Path) -> None:
    storage.put("maps/m/1/scan.ply", b"a scan")
    (tmp_path / "deleted-half" / "1").mkdir(parents=True)
    storage.replace("batches/b/results/00000.json", b"{}")
    (tmp_path / "batches" / "b" / "results" / ".00001.json.0f.tmp").write_bytes(b"{")
    storage.tidy()
    assert [entry.name for entry in (tmp_path / "batches" / "b" / "results").iterdir()] == ["00000.json"]
    assert storage.read("maps/m/1/scan.ply") == b"a scan"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["batches", "maps"]


def test_a_file_that_is_deleted_before_its_copy_is_opened_is_missing(storage: FolderStorage) -> None:
    storage.put("maps/m/1/points.ply", b"points")

    def open_late() -> None:
        with storage.local_copy("maps/m/1/points.ply") as path:
            storage.delete_all("maps/m")
            path.read_bytes()

    with pytest.raises(StoredFileMissingError):
        open_late()


def test_a_folder_is_named_by_a_path_or_a_url(tmp_path: Path) -> None:
    for url in (str(tmp_path), f"file://{tmp_path}"):
        open_storage(url).put("key", b"x")
        assert (tmp_path / "key").read_bytes() == b"x"
