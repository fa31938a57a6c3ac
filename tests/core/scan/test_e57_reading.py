"""E57 files, written with libE57 and then damaged by hand."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.sandbox import SandboxLimits
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.sandbox.reading import read_in_sandbox
from tests.core.scan.e57_files import CARTESIAN, RED_GREEN_BLUE, add_scan, pose_node, structure
from tests.core.scan.scan_files import CLOUD, assert_same_points, codes_of

libe57 = pytest.importorskip("pye57.libe57")
pye57 = pytest.importorskip("pye57")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
QUARTER_TURN_WXYZ = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


def add_colored(
    file: Any,
    columns: dict[str, NDArray[Any]],
    color_maximum: int | float | None = 255,
    rotation_wxyz: Sequence[float] | None = None,
    translation: Sequence[float] = (0, 0, 0),
) -> None:
    """Append a scan; colours are integers up to `color_maximum`, or floats without limits (None) or with (float)."""
    image_file, kinds, children = file.image_file, {}, {}
    for name in columns:
        if name.startswith("color") and isinstance(color_maximum, int):
            kinds[name] = libe57.IntegerNode(image_file, 0, 0, color_maximum)
        elif "Invalid" in name:
            kinds[name] = libe57.IntegerNode(image_file, 0, 0, 2)
    if isinstance(color_maximum, float):
        children["colorLimits"] = structure(image_file, **{f"{name}Maximum": color_maximum for name in RED_GREEN_BLUE})
    if rotation_wxyz is not None:
        children["pose"] = pose_node(image_file, rotation_wxyz, translation)
    add_scan(file, columns, kinds, **children)


def columns_of(scale: float = 1.0) -> dict[str, NDArray[Any]]:
    positions, colors = CLOUD.positions.T, CLOUD.colors.T * scale
    return dict(zip((*CARTESIAN, *RED_GREEN_BLUE), (*positions, *colors), strict=True))


def write_e57(path: Path, *scans: dict[str, Any]) -> Path:
    e57 = pye57.E57(str(path), mode="w")
    for scan in scans:
        add_colored(e57, **scan)
    e57.close()
    return path


@pytest.mark.parametrize(
    ("scale", "maximum"), [(1.0, 255), (1.0, 65535), (257.0, 65535), (1 / 255, 1.0), (1 / 255, None), (1.0, None)]
)
def test_colour_depths_are_told_apart(tmp_path: Path, scale: float, maximum: int | float | None) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(scale), "color_maximum": maximum})
    assert_same_points(read_scan(path))


def test_several_scans_are_merged_with_their_poses(tmp_path: Path) -> None:
    first = {"columns": columns_of()}
    second = {**first, "rotation_wxyz": QUARTER_TURN_WXYZ, "translation": (10, 20, 30)}
    found = read_scan(write_e57(tmp_path / "scan.e57", first, second))
    x, y, z = CLOUD.positions.T
    expected = np.concatenate([CLOUD.positions, np.stack([10 - y, 20 + x, 30 + z], axis=1)])
    np.testing.assert_allclose(found.positions, expected, atol=1e-5)
    assert "scans_merged" in codes_of(found)


def test_spherical_coordinates_are_converted(tmp_path: Path) -> None:
    x, y, z = CLOUD.positions.T.astype(np.float64)
    spherical = (np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))
    columns = dict(zip(SPHERICAL, spherical, strict=True)) | dict(list(columns_of().items())[3:])
    assert_same_points(read_scan(write_e57(tmp_path / "scan.e57", {"columns": columns})))


def test_points_that_the_scanner_calls_invalid_are_dropped(tmp_path: Path) -> None:
    state = np.zeros(len(CLOUD))
    state[[3, 8]] = [1, 2]
    columns = columns_of() | {"cartesianInvalidState": state}
    found = read_scan(write_e57(tmp_path / "scan.e57", {"columns": columns}))
    np.testing.assert_allclose(found.positions, np.delete(CLOUD.positions, [3, 8], axis=0), atol=1e-6)
    assert "non_finite_points" in codes_of(found)


def test_scans_without_colour_are_left_out_and_said(tmp_path: Path) -> None:
    gray = {"columns": dict(list(columns_of().items())[:3])}
    found = read_scan(write_e57(tmp_path / "scan.e57", gray, {"columns": columns_of()}))
    assert_same_points(found)
    assert "scans_without_color" in codes_of(found)
    with pytest.raises(ScanContentError, match="no colour"):
        read_scan(write_e57(tmp_path / "gray.e57", gray))


def test_a_file_without_scans_holds_no_points(tmp_path: Path) -> None:
    with pytest.raises(ScanContentError, match="no points"):
        read_scan(write_e57(tmp_path / "scan.e57"))


def test_a_cut_file_is_damaged(tmp_path: Path) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of()})
    whole = path.read_bytes()
    for kept in (20, 1000, -1024, -1):
        path.write_bytes(whole[:kept])
        with pytest.raises(ScanDamagedError, match="truncated"):
            read_scan(path)


def test_a_wrong_checksum_is_damage(tmp_path: Path) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of()})
    data = bytearray(path.read_bytes())
    data[600] ^= 1
    path.write_bytes(data)
    with pytest.raises(ScanDamagedError, match="checksum"):
        read_scan(path)


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


def description(children: bytes, document_type: bytes = b"") -> bytes:
    space = b'xmlns="http://www.astm.org/COMMIT/E57/2010-e57-v1.0" xmlns:d="urn:d"'
    start = b'<?xml version="1.0" encoding="UTF-8"?>' + document_type
    return start + b'<e57Root type="Structure" ' + space + b">" + children + b"</e57Root>"


@pytest.mark.parametrize(
    ("name", "xml"),
    [
        ("an entity", description(b'<d:a type="String">&b;</d:a>', b'<!DOCTYPE a [<!ENTITY b "c">]>')),
        ("a file", description(b"", b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/hostname">]>')),
        ("a document type of its own", description(b"", b'<!DOCTYPE a SYSTEM "file:///etc/hostname">')),
        ("no end", description(b"<d:a>")),
        ("nothing", b""),
    ],
)
def test_the_parser_refuses_xml_entities_and_damage(tmp_path: Path, name: str, xml: bytes) -> None:
    path = tmp_path / f"{name}.e57"
    path.write_bytes(e57_of(xml))
    with pytest.raises(ScanDamagedError, match="damaged"):
        read_scan(path)


@pytest.mark.slow
def test_the_sandbox_stops_nodes_that_take_too_long_to_compare(tmp_path: Path) -> None:
    # libE57 compares each node with all before it: 20,000 take 4 s, 60,000 take 37 s of the 900 that a reader has.
    path = tmp_path / "scan.e57"
    path.write_bytes(e57_of(description(b"".join(b'<d:a%d type="Integer"/>' % number for number in range(20_000)))))
    context = ReadingContext(path, ScanOptions(), path.stat().st_size)
    with pytest.raises(ScanError, match="takes longer than 1 s"):
        list(read_in_sandbox("e57", context, SandboxLimits(cpu_s=1)))


def test_a_name_outside_ascii_is_opened(tmp_path: Path) -> None:
    assert_same_points(read_scan(write_e57(tmp_path / "测试.e57", {"columns": columns_of()})))
