"""The content decides which format a file has; its name is only the second sign."""

import numpy as np
import pytest

from panoloc.core.errors import ScanDamagedError, ScanFormatError
from panoloc.core.scan.format_detection import extension_of
from panoloc.core.scan.ply.writer import encode_ply
from tests.core.scan.scan_files import CLOUD, read


@pytest.mark.parametrize("name", ["scan.las", "scan.PCD", "scan.xyz", "scan.jpg"])
def test_a_wrong_extension_is_resolved_by_the_content_and_said(name: str) -> None:
    found = read(name, encode_ply(CLOUD))
    np.testing.assert_array_equal(found.positions, CLOUD.positions)
    assert found.diagnostics[0].code == "extension_mismatch"
    assert found.diagnostics[0].severity == "warning"
    assert "PLY" in found.diagnostics[0].message


@pytest.mark.parametrize("name", ["scan.ply", "SCAN.PLY", "scan"])
def test_a_fitting_extension_or_none_needs_no_remark(name: str) -> None:
    assert read(name, encode_ply(CLOUD), format="ply").diagnostics == ()
    assert read(name, encode_ply(CLOUD)).diagnostics == ()


@pytest.mark.parametrize("name", ["scan.ply", "scan.pcd", "scan.las", "scan.laz", "scan.e57"])
def test_text_under_a_binary_name_is_an_unresolved_disagreement(name: str) -> None:
    with pytest.raises(ScanFormatError, match=rf"named \.{name[-3:]}.*plain text"):
        read(name, "0 0 0 1 2 3\n1 1 1 4 5 6\n")


def test_the_format_option_stands_in_for_a_missing_extension() -> None:
    text = "0 0 0 1 2 3\n1 1 1 4 5 6\n"
    assert len(read("upload", text, format=".xyz")) == 2
    with pytest.raises(ScanFormatError, match=r"named \.ply.*plain text"):
        read("upload", text, format=".ply")


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (b"\x89PNG\r\n\x1a\n", "PNG image"),
        (b"\xff\xd8\xff\xe0", "JPEG image"),
        (b"\x1f\x8b\x08", "gzip archive"),
        (b"%PDF-1.7", "PDF"),
        (b"\x00\x01\x02\x03", "unknown binary data"),
    ],
)
def test_other_files_are_named(start: bytes, said: str) -> None:
    for name in ("scan.ply", "scan.xyz", "scan"):
        with pytest.raises(ScanFormatError, match=said):
            read(name, start + bytes(100))


def test_an_empty_file_is_said_to_be_empty() -> None:
    with pytest.raises(ScanDamagedError, match=r"empty \(0 bytes\)"):
        read("scan.ply", b"")


@pytest.mark.parametrize("content", [b"\n\n\n", b" ", b"\xef\xbb\xbf", b"\r"])
def test_white_space_is_not_a_scan(content: bytes) -> None:
    with pytest.raises(ScanFormatError):
        read("scan.xyz", content)


@pytest.mark.parametrize(
    ("name", "extension"),
    [
        ("a.PLY", ".ply"),
        ("a", ""),
        ("C:\\scans\\a.e57", ".e57"),
        ("../../a.xyz", ".xyz"),
        ("a.ply/..", ""),
        ("a.b c", ""),
    ],
)
def test_only_a_plain_extension_reaches_the_storage(name: str, extension: str) -> None:
    assert extension_of(name) == extension
