from pathlib import Path

import pytest

from service.host.run_folder import DataFolderInUseError, RunFolder


def test_a_second_service_on_the_same_data_is_kept_out(tmp_path: Path) -> None:
    first = RunFolder(tmp_path)
    with pytest.raises(DataFolderInUseError, match="process id"):
        RunFolder(tmp_path)
    first.close()
    RunFolder(tmp_path).close()


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
