"""Archives of strangers are opened within limits, and what no file in them may be is told in one place."""

import struct
import zipfile
from pathlib import Path

import pytest

from panoloc.core.scan.zip_opening import leads_out, open_zip, unpacked_bytes


def zip_at(path: Path, names: list[str]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            archive.writestr(name, b"1")
    return path


def test_a_list_of_files_that_is_too_long_is_refused_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = zip_at(tmp_path / "a.zip", [f"{number}.ply" for number in range(30)])
    monkeypatch.setattr("panoloc.core.scan.zip_opening.MAX_LIST_BYTES", 1000)
    with pytest.raises(zipfile.BadZipFile, match="list of files takes"), open_zip(path):
        pass
    monkeypatch.undo()
    with open_zip(path) as archive:
        assert len(archive.namelist()) == 30
        assert archive.read("7.ply") == b"1"


def test_an_archive_counts_with_what_it_holds_and_anything_else_with_itself(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("table.xyz", b"0 0 0\n" * 10_000)
    assert path.stat().st_size < 1000
    assert unpacked_bytes(path, 10**9) == 60_000
    assert unpacked_bytes(path, 5000) == 5000
    assert unpacked_bytes(path, 1) == path.stat().st_size
    (tmp_path / "scan.ply").write_bytes(b"ply" * 100)
    assert unpacked_bytes(tmp_path / "scan.ply", 10**9) == 300


def test_a_file_without_a_name_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr("a", b"1")
        archive.infolist()[0].filename = ""
    with pytest.raises(zipfile.BadZipFile, match="no name"), open_zip(tmp_path / "a.zip"):
        pass


def test_an_end_that_lies_is_no_zip(tmp_path: Path) -> None:
    data = bytearray(zip_at(tmp_path / "a.zip", ["a"]).read_bytes())
    end = data.rindex(b"PK\x05\x06")
    data[end + 12 : end + 16] = struct.pack("<I", 0xFFFFFFF0)
    (tmp_path / "b.zip").write_bytes(data)
    with pytest.raises(zipfile.BadZipFile), open_zip(tmp_path / "b.zip"):
        pass


@pytest.mark.parametrize("name", ["../b", "a/../../b", "a\\..\\b", "/b", "\\\\host\\b", "C:b", "a\x00b"])
def test_names_that_lead_out_are_told(name: str) -> None:
    assert leads_out(name)
    assert not leads_out("a/b.ply")
    assert not leads_out("a..b/c.ply")
