import stat
import tempfile
from pathlib import Path

import pytest

from panoloc.service.host.run_folder import DataFolderInUseError, RunFolder


def test_a_second_service_on_the_same_data_is_kept_out(tmp_path: Path) -> None:
    first = RunFolder(tmp_path)
    with pytest.raises(DataFolderInUseError, match="process id"):
        RunFolder(tmp_path)
    first.close()
    RunFolder(tmp_path).close()


def test_a_data_folder_that_cannot_be_made_is_named_with_its_setting(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(OSError, match=r"got .*/file/data \(Not a directory\); correct PANOLOC_DATA_DIR"):
        RunFolder(tmp_path / "file" / "data")


def test_a_data_folder_that_is_made_is_for_its_user_alone_and_one_that_is_there_stays_as_it_is(tmp_path: Path) -> None:
    given = tmp_path / "given"
    given.mkdir(0o755)
    for folder, mode in ((given, 0o755), (tmp_path / "new" / "data", 0o700)):
        RunFolder(folder).close()
        assert stat.S_IMODE(folder.stat().st_mode) == mode


def test_what_a_killed_service_left_is_removed(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    (folder.path / "session" / "logs").mkdir(parents=True)
    (folder.path / "redis.log").write_text("old")
    folder._lock.close()  # what the kernel does to a killed process
    second = RunFolder(tmp_path)
    assert [entry.name for entry in second.path.iterdir() if entry.name != "lock"] == []
    second.close()


def test_a_long_data_folder_gets_a_path_short_enough_for_sockets_that_goes_with_the_service(tmp_path: Path) -> None:
    folder, other = RunFolder(tmp_path / ("long" * 20)), RunFolder(tmp_path / ("other" * 20))
    assert other.path != folder.path
    for each in (folder, other):
        assert len(str(each.path / "redis.sock")) <= 103
        assert each.path.stat().st_mode & 0o077 == 0
        (each.path / "redis.log").touch()
        each.close()
        assert not each.path.exists()


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


def test_services_that_share_the_data_let_each_other_in_and_nobody_else(tmp_path: Path) -> None:
    first, second = RunFolder(tmp_path, is_shared=True), RunFolder(tmp_path, is_shared=True)
    with pytest.raises(DataFolderInUseError, match="PANOLOC_SHARED for both"):
        RunFolder(tmp_path)
    first.close()
    second.close()
    alone = RunFolder(tmp_path)
    with pytest.raises(DataFolderInUseError, match="PANOLOC_SHARED for both"):
        RunFolder(tmp_path, is_shared=True)
    alone.close()
