"""The XML of an E57 file is bounded before libE57 sees it."""

import struct
import time
from pathlib import Path

import pytest

from core.errors import ScanContentError, ScanDamagedError, ScanError
from core.scan.e57.description import check_description
from core.scan.reading import read_scan

pytest.importorskip("pye57")

ROOT = b"""<?xml version="1.0" encoding="UTF-8"?>
<e57Root type="Structure" xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0" xmlns:d="urn:d">%s</e57Root>"""


def crc32c(data: bytes) -> int:
    """Return the checksum of a page, ASTM E2807 (Castagnoli)."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def e57_of(xml: bytes) -> bytes:
    """Return a file that holds nothing but a description."""
    num_pages = -(-(48 + len(xml)) // 1020)
    header = struct.pack("<8sIIQQQQ", b"ASTM-E57", 1, 0, num_pages * 1024, 48, len(xml), 1024)
    content = (header + xml).ljust(num_pages * 1020, b"\0")
    pages = [content[at : at + 1020] for at in range(0, len(content), 1020)]
    return b"".join(page + struct.pack(">I", crc32c(page)) for page in pages)


def siblings(count: int) -> bytes:
    return ROOT % b"".join(b'<d:a%d type="Integer"/>' % number for number in range(count))


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        (siblings(20_000), "structure of more than 256 children"),
        (ROOT % (b'<d:a type="Structure">' * 100_000 + b"</d:a>" * 100_000), "more than 64 levels"),
        (ROOT % (b'<d:v type="Vector">' + b"<d:a/>" * 600_000 + b"</d:v>"), "more than 500,000 nodes"),
        (ROOT % (b"<d:a " + b" ".join(b'b%d=""' % each for each in range(100)) + b"/>"), "100 attributes"),
    ],
    ids=["siblings", "levels", "nodes", "attributes"],
)
def test_xml_that_no_scanner_writes_is_refused_in_linear_time(xml: bytes, said: str) -> None:
    began = time.process_time()
    with pytest.raises(ScanContentError, match=said):
        check_description(xml)
    assert time.process_time() - began < 5


def test_a_file_of_siblings_is_refused_before_libe57_compares_them_all(tmp_path: Path) -> None:
    path = tmp_path / "scan.e57"
    path.write_bytes(e57_of(siblings(2000)))
    with pytest.raises(ScanContentError, match="structure of more than 256 children"):
        read_scan(path)


def test_an_e57_of_thousands_of_stations_and_pictures_passes() -> None:
    station = b'<v type="Structure">' + b'<x type="Float">1</x>' * 30 + b"</v>"
    check_description(ROOT % (b'<data3D type="Vector">' + station * 5000 + b"</data3D>"))


@pytest.mark.parametrize("xml", [ROOT % b"<d:a>", b"", b"\xff\xfe"])
def test_xml_that_is_none_is_damage(xml: bytes) -> None:
    with pytest.raises(ScanDamagedError, match="is damaged"):
        check_description(xml)


def test_a_document_type_hides_in_no_other_encoding() -> None:
    text = '<?xml version="1.0" encoding="cp037"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'
    with pytest.raises(ScanError):
        check_description(text.encode("cp037"))
