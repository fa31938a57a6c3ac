"""Files survive crashes whole, and damage does not pass unnoticed."""

import hashlib
import os
import re
from pathlib import Path

import pytest

from service.errors import StorageFullError, StorageReadOnlyError, StoredFileDamagedError, StoredFileMissingError
from service.storage import FolderStorage, open_storage


@pytest.fixture
def storage(tmp_path: Path) -> FolderStorage:
    return FolderStorage(tmp_path)


def test_what_is_put_is_read_back(storage: FolderStorage, tmp_path: Path) -> None:
    storage.put("maps/m/1/preview.png", b"one")
    storage.put("maps/m/1/preview.png", b"two")
    assert storage.read("maps/m/1/preview.png") == b"two"
    assert (tmp_path / "maps/m/1/preview.png.sha256").read_text() == hashlib.sha256(b"two").hexdigest() + "\n"
    with storage.local_copy("maps/m/1/preview.png") as path:
        assert path.read_bytes() == b"two"


def test_an_upload_is_moved_in_with_its_digest(storage: FolderStorage) -> None:
    upload = storage.spool_folder() / "upload"
    upload.write_bytes(b"a scan")
    storage.adopt("maps/m/1/scan.ply", upload, hashlib.sha256(b"a scan").hexdigest())
    assert not upload.exists()
    assert storage.read("maps/m/1/scan.ply") == b"a scan"


@pytest.mark.parametrize("way", ["read", "local_copy"])
def test_a_file_that_was_changed_on_the_disk_is_not_used(storage: FolderStorage, tmp_path: Path, way: str) -> None:
    storage.put("maps/m/1/scan.ply", b"a scan")
    (tmp_path / "maps/m/1/scan.ply").write_bytes(b"a scam")
    with pytest.raises(StoredFileDamagedError, match="expected the SHA-256"):
        storage.read("maps/m/1/scan.ply") if way == "read" else storage.local_copy("maps/m/1/scan.ply").__enter__()


@pytest.mark.parametrize("way", ["read", "local_copy"])
def test_a_file_that_is_not_there_is_said_to_be_missing(storage: FolderStorage, way: str) -> None:
    with pytest.raises(StoredFileMissingError, match="maps/none"):
        storage.read("maps/none") if way == "read" else storage.local_copy("maps/none").__enter__()


@pytest.mark.parametrize("moment", ["fsync", "replace"])
def test_a_crash_while_writing_leaves_the_old_bytes(
    storage: FolderStorage, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    storage.replace("maps/m/map.json", b"old")

    class PowerCutError(BaseException):
        pass

    def cut(*_: object, **__: object) -> None:
        raise PowerCutError

    with monkeypatch.context() as patch:
        patch.setattr(os if moment == "fsync" else Path, moment, cut)
        # Nothing of ours runs any more once the process is gone.
        patch.setattr(Path, "unlink", lambda *_, **__: None)
        with pytest.raises(PowerCutError):
            storage.replace("maps/m/map.json", b"new")
    assert storage.read("maps/m/map.json") == b"old"
    assert storage.names("maps/m") == ["map.json"]
    storage.tidy()
    assert [entry.name for entry in storage._path("maps/m").iterdir()] == ["map.json"]


def test_bytes_are_on_the_disk_before_their_name_is(storage: FolderStorage, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def noted_fsync(descriptor: int) -> None:
        steps.append("fsync")
        fsync(descriptor)

    def noted_replace(self: Path, target: Path) -> Path:
        steps.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    storage.replace("map.json", b"data")
    assert steps == ["fsync", "rename", "fsync"]


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Note what is synced and what is renamed to what, in order, with the unfinished files' random parts left out."""
    steps: list[str] = []
    fsync, replace, rename = os.fsync, Path.replace, Path.rename

    def noting_fsync(descriptor: int) -> None:
        name = Path(os.readlink(f"/proc/self/fd/{descriptor}")).name
        steps.append("sync " + re.sub(r"^\.(.*)\.[0-9a-f]{32}\.tmp$", r"unfinished \1", name))
        fsync(descriptor)

    def noting_replace(self: Path, target: Path) -> Path:
        steps.append(f"name {target.name}")
        return replace(self, target)

    def noting_rename(self: Path, target: Path) -> Path:
        steps.append(f"move {self.name}")
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", noting_fsync)
    monkeypatch.setattr(Path, "replace", noting_replace)
    monkeypatch.setattr(Path, "rename", noting_rename)
    return steps


DIGEST_WRITTEN = ["sync unfinished scan.ply.sha256", "name scan.ply.sha256", "sync 1"]


def test_a_scan_its_digest_and_its_folders_are_on_the_disk_before_the_upload_is_over(
    storage: FolderStorage, tmp_path: Path, steps: list[str]
) -> None:
    upload = storage.spool_folder() / "upload"
    upload.write_bytes(b"a scan")
    storage.adopt("maps/m/1/scan.ply", upload, hashlib.sha256(b"a scan").hexdigest())
    new_folders = [f"sync {tmp_path.name}", "sync maps", "sync m"]
    assert steps == [*new_folders, *DIGEST_WRITTEN, "sync upload", "name scan.ply", "sync 1"]


def test_bytes_that_are_put_come_after_their_digest(storage: FolderStorage, tmp_path: Path, steps: list[str]) -> None:
    (tmp_path / "maps/m/1").mkdir(parents=True)
    storage.put("maps/m/1/scan.ply", b"a scan")
    assert steps == [*DIGEST_WRITTEN, "sync unfinished scan.ply", "name scan.ply", "sync 1"]


def test_a_deletion_is_on_the_disk_before_it_is_over(storage: FolderStorage, steps: list[str]) -> None:
    storage.put("maps/m/1/scan.ply", b"a scan")
    steps.clear()
    storage.delete_all("maps/m")
    assert steps == ["move m", "sync maps"]


@pytest.mark.parametrize("way", ["put", "adopt"])
def test_no_moment_leaves_a_file_that_nothing_would_check(
    storage: FolderStorage, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    class PowerCutError(BaseException):
        pass

    upload = storage.spool_folder() / "upload"
    upload.write_bytes(b"a scan")
    num_renamed = 0
    replace = Path.replace

    def cut_after_the_first(self: Path, target: Path) -> Path:
        nonlocal num_renamed
        num_renamed += 1
        if num_renamed > 1:
            raise PowerCutError
        return replace(self, target)

    def write() -> None:
        if way == "put":
            storage.put("maps/m/1/scan.ply", b"a scan")
        else:
            storage.adopt("maps/m/1/scan.ply", upload, hashlib.sha256(b"a scan").hexdigest())

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", cut_after_the_first)
        with pytest.raises(PowerCutError):
            write()
    with pytest.raises(StoredFileMissingError):
        storage.read("maps/m/1/scan.ply")


def test_a_write_that_fails_leaves_nothing_behind(
    storage: FolderStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageFullError, match="the disk is full"):
        storage.replace("map.json", b"data")
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_cannot_begin_says_why(storage: FolderStorage, tmp_path: Path) -> None:
    (tmp_path / "map.json").mkdir()
    too_long = "a" * 250
    with pytest.raises(OSError, match="File name too long"):
        storage.replace(too_long, b"data")
    with pytest.raises(IsADirectoryError):
        storage.replace("map.json", b"data")
    assert [entry.name for entry in tmp_path.iterdir()] == ["map.json"]


@pytest.mark.parametrize(
    ("number", "said"), [(28, StorageFullError), (30, StorageReadOnlyError), (13, StorageReadOnlyError)]
)
def test_a_storage_that_takes_nothing_says_so_when_it_is_asked(
    storage: FolderStorage, monkeypatch: pytest.MonkeyPatch, number: int, said: type[Exception]
) -> None:
    storage.check_writable()

    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(said):
        storage.check_writable()
    assert list(storage.spool_folder().iterdir()) == []


def test_a_map_can_be_deleted_from_a_disk_without_room_for_a_folder(
    storage: FolderStorage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage.put("maps/m/map.json", b"record")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", full)
    storage.delete_all("maps/m")
    assert storage.names("maps") == []
    assert [entry.name for entry in tmp_path.iterdir()] == ["maps"]


def test_uploads_share_a_folder(storage: FolderStorage, tmp_path: Path) -> None:
    (storage.spool_folder() / "one").touch()
    assert storage.spool_folder() == tmp_path / "uploads"
    assert (tmp_path / "uploads" / "one").exists()


def test_deleting_takes_everything_below_at_once(storage: FolderStorage, tmp_path: Path) -> None:
    storage.put("maps/m/1/scan.ply", b"a scan")
    storage.delete_all("maps/m")
    storage.delete_all("maps/m")
    assert storage.names("maps") == []
    assert list(tmp_path.rglob("scan.ply*")) == []


def test_tidying_removes_what_a_crash_left_and_nothing_else(storage: FolderStorage, tmp_path: Path) -> None:
    storage.put("maps/m/1/scan.ply", b"a scan")
    (storage.spool_folder() / "half").write_bytes(b"half")
    (tmp_path / "trash" / "gone").mkdir(parents=True)
    storage.replace("batches/b/results/00000.json", b"{}")
    (tmp_path / "batches" / "b" / "results" / ".00001.json.0f.tmp").write_bytes(b"{")
    storage.tidy()
    assert [entry.name for entry in (tmp_path / "batches" / "b" / "results").iterdir()] == ["00000.json"]
    assert storage.read("maps/m/1/scan.ply") == b"a scan"
    assert not (tmp_path / "uploads").exists()
    assert not (tmp_path / "trash").exists()


@pytest.mark.parametrize("key", ["../x", "maps/../../x", "/etc/passwd", "", "a//b", "a/\0", "a\\..\\b", "."])
def test_a_key_never_leaves_the_folder(storage: FolderStorage, key: str) -> None:
    with pytest.raises(StoredFileMissingError, match="expected a key such as"):
        storage.read(key)
    with pytest.raises(StoredFileMissingError, match="expected a key such as"):
        storage.put(key, b"x")


def test_a_storage_is_named_by_a_folder_or_a_url(tmp_path: Path) -> None:
    for url in (str(tmp_path), f"file://{tmp_path}"):
        open_storage(url).put("key", b"x")
        assert (tmp_path / "key").read_bytes() == b"x"
    with pytest.raises(ValueError, match="s3://"):
        open_storage("s3://bucket")
