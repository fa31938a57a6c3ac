"""E57 files, written with libE57 and then damaged by hand."""

import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError, ScanError
from panoloc.core.options import ScanOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.core.scan.sandbox.limits import SandboxLimits
from panoloc.core.scan.sandbox.reading import read_in_sandbox

libe57 = pytest.importorskip("pye57.libe57")
pye57 = pytest.importorskip("pye57")
Compare = Callable[..., None]
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
QUARTER_TURN_WXYZ = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


def add_scan(
    e57: Any,
    columns: dict[str, NDArray[Any]],
    color_maximum: int | float | None = 255,
    rotation_wxyz: Sequence[float] | None = None,
    translation: Sequence[float] = (0, 0, 0),
) -> None:
    """Append a scan; colours are integers up to `color_maximum`, or floats without limits (None) or with (float)."""
    image_file = e57.image_file
    scan, prototype = libe57.StructureNode(image_file), libe57.StructureNode(image_file)
    buffers, kept = libe57.VectorSourceDestBuffer(), []
    for name, column in columns.items():
        if name.startswith("color") and isinstance(color_maximum, int):
            node = libe57.IntegerNode(image_file, 0, 0, color_maximum)
        elif "Invalid" in name:
            node = libe57.IntegerNode(image_file, 0, 0, 2)
        else:
            node = libe57.FloatNode(image_file, 0.0, libe57.E57_DOUBLE)
        prototype.set(name, node)
        kept.append(np.ascontiguousarray(column, np.float64))
        buffers.append(libe57.SourceDestBuffer(image_file, name, kept[-1], len(column), True, True))
    if isinstance(color_maximum, float):
        limits = libe57.StructureNode(image_file)
        for color in ("Red", "Green", "Blue"):
            limits.set(f"color{color}Maximum", libe57.FloatNode(image_file, color_maximum))
        scan.set("colorLimits", limits)
    if rotation_wxyz is not None:
        scan.set("pose", pose_node(image_file, rotation_wxyz, translation))
    points = libe57.CompressedVectorNode(image_file, prototype, libe57.VectorNode(image_file, True))
    scan.set("points", points)
    e57.data3d.append(scan)
    writer = points.writer(buffers)
    writer.write(len(kept[0]))
    writer.close()


def pose_node(image_file: Any, rotation_wxyz: Sequence[float], translation: Sequence[float]) -> Any:
    pose = libe57.StructureNode(image_file)
    for name, axes, values in (("rotation", "wxyz", rotation_wxyz), ("translation", "xyz", translation)):
        part = libe57.StructureNode(image_file)
        for axis, value in zip(axes, values, strict=True):
            part.set(axis, libe57.FloatNode(image_file, float(value)))
        pose.set(name, part)
    return pose


def columns_of(cloud: PointCloud, scale: float = 1.0) -> dict[str, NDArray[Any]]:
    columns = {name: cloud.positions[:, axis] for axis, name in enumerate(CARTESIAN)}
    colors = {name: cloud.colors[:, axis] * scale for axis, name in enumerate(("colorRed", "colorGreen", "colorBlue"))}
    return {**columns, **colors}


def write_e57(path: Path, *scans: dict[str, Any]) -> Path:
    e57 = pye57.E57(str(path), mode="w")
    for scan in scans:
        add_scan(e57, **scan)
    e57.close()
    return path


@pytest.mark.parametrize(
    ("scale", "maximum"), [(1.0, 255), (1.0, 65535), (257.0, 65535), (1 / 255, 1.0), (1 / 255, None), (1.0, None)]
)
def test_colour_depths_are_told_apart(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare, scale: float, maximum: int | float | None
) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(cloud, scale), "color_maximum": maximum})
    assert_same_points(read_scan(path), cloud)


def test_several_scans_are_merged_with_their_poses(cloud: PointCloud, tmp_path: Path) -> None:
    first = {"columns": columns_of(cloud)}
    second = {**first, "rotation_wxyz": QUARTER_TURN_WXYZ, "translation": (10, 20, 30)}
    read = read_scan(write_e57(tmp_path / "scan.e57", first, second))
    x, y, z = cloud.positions.T
    expected = np.concatenate([cloud.positions, np.stack([10 - y, 20 + x, 30 + z], axis=1)])
    np.testing.assert_allclose(read.positions, expected, atol=1e-5)
    assert "scans_merged" in [note.code for note in read.diagnostics]


def test_spherical_coordinates_are_converted(cloud: PointCloud, tmp_path: Path, assert_same_points: Compare) -> None:
    x, y, z = cloud.positions.T.astype(np.float64)
    spherical = (np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)))
    columns = dict(zip(SPHERICAL, spherical, strict=True)) | dict(list(columns_of(cloud).items())[3:])
    assert_same_points(read_scan(write_e57(tmp_path / "scan.e57", {"columns": columns})), cloud)


def test_points_that_the_scanner_calls_invalid_are_dropped(cloud: PointCloud, tmp_path: Path) -> None:
    state = np.zeros(len(cloud))
    state[[3, 8]] = [1, 2]
    columns = columns_of(cloud) | {"cartesianInvalidState": state}
    read = read_scan(write_e57(tmp_path / "scan.e57", {"columns": columns}))
    np.testing.assert_allclose(read.positions, np.delete(cloud.positions, [3, 8], axis=0), atol=1e-6)
    assert "non_finite_points" in [note.code for note in read.diagnostics]


def test_scans_without_colour_are_left_out_and_said(
    cloud: PointCloud, tmp_path: Path, assert_same_points: Compare
) -> None:
    gray = {"columns": dict(list(columns_of(cloud).items())[:3])}
    read = read_scan(write_e57(tmp_path / "scan.e57", gray, {"columns": columns_of(cloud)}))
    assert_same_points(read, cloud)
    assert "scans_without_color" in [note.code for note in read.diagnostics]
    with pytest.raises(ScanContentError, match="no colour"):
        read_scan(write_e57(tmp_path / "gray.e57", gray))


def test_a_file_without_scans_holds_no_points(tmp_path: Path) -> None:
    with pytest.raises(ScanContentError, match="no points"):
        read_scan(write_e57(tmp_path / "scan.e57"))


def test_a_cut_file_is_damaged(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(cloud)})
    whole = path.read_bytes()
    for kept in (20, 1000, -1024, -1):
        path.write_bytes(whole[:kept])
        with pytest.raises(ScanDamagedError, match="truncated"):
            read_scan(path)


def test_a_wrong_checksum_is_damage(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(cloud)})
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


def test_the_sandbox_stops_nodes_that_take_too_long_to_compare(tmp_path: Path) -> None:
    # libE57 compares each node with all before it: 20,000 take 4 s, 60,000 take 37 s of the 900 that a reader has.
    path = tmp_path / "scan.e57"
    path.write_bytes(e57_of(description(b"".join(b'<d:a%d type="Integer"/>' % number for number in range(20_000)))))
    context = ReadingContext(path, ScanOptions(), path.stat().st_size)
    with pytest.raises(ScanError, match="takes longer than 1 s"):
        list(read_in_sandbox("e57", context, SandboxLimits(cpu_s=1)))


def test_a_name_outside_ascii_is_opened(cloud: PointCloud, tmp_path: Path, assert_same_points: Compare) -> None:
    assert_same_points(read_scan(write_e57(tmp_path / "测试.e57", {"columns": columns_of(cloud)})), cloud)
