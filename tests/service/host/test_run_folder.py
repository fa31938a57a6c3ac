import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.host.run_folder import DataFolderInUseError, DataFolderUnusableError, RunFolder

LONG_NAME = "long" * 20


def test_a_second_service_on_the_same_data_is_kept_out(tmp_path: Path) -> None:
    first = RunFolder(tmp_path)
    with pytest.raises(DataFolderInUseError, match="process id"):
        RunFolder(tmp_path)
    first.close()
    RunFolder(tmp_path).close()


def test_a_data_folder_that_cannot_be_made_is_named_with_its_setting(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(
        DataFolderUnusableError, match=r"got .*/file/data \(Not a directory\); correct PANOLOC_DATA_DIR"
    ):
        RunFolder(tmp_path / "file" / "data")


def test_what_a_killed_service_left_is_removed(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    (folder.path / "ray" / "session").mkdir(parents=True)
    (folder.path / "redis.log").write_text("old")
    folder._lock.close()  # what the kernel does to a killed process
    second = RunFolder(tmp_path)
    assert [entry.name for entry in second.path.iterdir() if entry.name != "lock"] == []
    second.close()


def test_a_long_data_folder_gets_a_path_short_enough_for_sockets(tmp_path: Path) -> None:
    deep = tmp_path / ("long" * 20)
    folder = RunFolder(deep)
    assert len(str(folder.path)) <= 32
    assert folder.path.stat().st_mode & 0o077 == 0
    other = RunFolder(tmp_path / ("other" * 20))
    assert other.path != folder.path
    for each in (folder, other):
        each.close()
        assert not each.path.exists()  # nothing is left in /tmp


@pytest.fixture
def stand_in(tmp_path: Path) -> Iterator[Path]:
    """Return the path in /tmp that stands in for the run folder of `tmp_path / LONG_NAME`, with nothing there."""
    folder = RunFolder(tmp_path / LONG_NAME)
    folder.close()
    assert folder.path.parent == Path("/tmp")
    yield folder.path
    if folder.path.is_symlink():
        folder.path.unlink()
    elif folder.path.exists():
        (folder.path / "theirs").unlink(missing_ok=True)
        folder.path.rmdir()


def test_a_folder_of_somebody_else_in_its_place_is_refused_and_left_alone(
    tmp_path: Path, stand_in: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in.mkdir()
    (stand_in / "theirs").touch()
    own_user = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: own_user + 1)
    with pytest.raises(PermissionError, match=f"expected a folder of our own user, got one of user {own_user}"):
        RunFolder(tmp_path / LONG_NAME)
    assert (stand_in / "theirs").exists()


def test_a_link_in_its_place_is_refused_although_it_leads_to_a_folder_of_ours(tmp_path: Path, stand_in: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "precious").touch()
    stand_in.symlink_to(tmp_path / "kept")
    with pytest.raises(PermissionError, match="remove it"):
        RunFolder(tmp_path / LONG_NAME)
    assert (tmp_path / "kept" / "precious").exists()


def test_a_folder_of_ours_that_is_open_to_others_is_closed_to_them(tmp_path: Path, stand_in: Path) -> None:
    stand_in.mkdir()
    stand_in.chmod(0o777)
    folder = RunFolder(tmp_path / LONG_NAME)
    assert folder.path == stand_in
    assert stand_in.stat().st_mode & 0o777 == 0o700
    folder.close()


def test_links_left_in_the_folder_are_removed_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").touch()
    with tempfile.TemporaryDirectory(prefix="pl-", dir="/tmp") as data:  # short enough to need no stand-in
        link = Path(data) / "run" / "link"
        link.parent.mkdir()
        link.symlink_to(tmp_path)
        folder = RunFolder(Path(data))
        assert folder.path == link.parent
        assert not link.is_symlink()
        folder.close()
        assert [entry.name for entry in link.parent.iterdir()] == ["lock"]
    assert (tmp_path / "precious").exists()


def test_nobody_else_enters_the_folder_of_a_short_path_either() -> None:
    with tempfile.TemporaryDirectory(dir="/tmp", prefix="p") as short:
        (Path(short) / "run").mkdir(mode=0o777)
        folder = RunFolder(Path(short))
        try:
            assert folder.path == Path(short).resolve() / "run"
            assert stat.S_IMODE(folder.path.stat().st_mode) == 0o700
        finally:
            folder.close()


def test_services_that_share_the_data_have_folders_of_their_own(tmp_path: Path) -> None:
    first, second = RunFolder(tmp_path, is_shared=True), RunFolder(tmp_path, is_shared=True)
    assert first.path != second.path
    assert {folder.path.parent for folder in (first, second)} == {Path("/tmp")}
    with pytest.raises(DataFolderInUseError, match="PANOLOC_SHARED"):
        RunFolder(tmp_path)
    first.close()
    again = RunFolder(tmp_path, is_shared=True)
    assert again.path == first.path
    again.close()
    second.close()
    for folder in (first, second):
        (folder.path / "lock").unlink()
        folder.path.rmdir()
    RunFolder(tmp_path).close()


def test_a_service_alone_keeps_out_those_that_would_share(tmp_path: Path) -> None:
    alone = RunFolder(tmp_path)
    with pytest.raises(DataFolderInUseError, match="expected a data folder that only services with PANOLOC_SHARED use"):
        RunFolder(tmp_path, is_shared=True)
    alone.close()
