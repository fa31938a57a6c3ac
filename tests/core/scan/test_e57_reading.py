"""E57 files, written with libE57 and then damaged by hand."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from core.errors import ScanContentError, ScanDamagedError
from core.scan.point_cloud import PointCloud
from core.scan.reading import read_scan

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


@pytest.mark.parametrize("kept", [20, 1000, -1024, -1])
def test_a_cut_file_is_damaged(cloud: PointCloud, tmp_path: Path, kept: int) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(cloud)})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(ScanDamagedError, match=r"bytes.*cut short"):
        read_scan(path)


def test_a_wrong_checksum_is_damage(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(cloud)})
    data = bytearray(path.read_bytes())
    data[600] ^= 1
    path.write_bytes(data)
    with pytest.raises(ScanDamagedError, match="checksum"):
        read_scan(path)


def test_xml_entities_are_refused_before_the_parser_sees_them(cloud: PointCloud, tmp_path: Path) -> None:
    path = write_e57(tmp_path / "scan.e57", {"columns": columns_of(cloud)})
    data = path.read_bytes()
    start = data.index(b"<e57Root")
    entity = b'<!DOCTYPE a [<!ENTITY b "c">]>'
    path.write_bytes(data[:start] + entity + data[start + len(entity) :])
    with pytest.raises(ScanDamagedError, match="XML entities"):
        read_scan(path)


def test_a_name_outside_ascii_is_opened(cloud: PointCloud, tmp_path: Path, assert_same_points: Compare) -> None:
    assert_same_points(read_scan(write_e57(tmp_path / "测试.e57", {"columns": columns_of(cloud)})), cloud)
