"""Coordinate systems that LAS, LAZ and E57 files name."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from laspy.vlrs.known import GeoKeyDirectoryVlr, WktCoordinateSystemVlr
from pye57 import E57, libe57
from pyproj import CRS

from panoloc.core.errors import ScanContentError
from panoloc.core.options import ScanOptions, Unit, UpAxis
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from tests.core.scan.mesh_files import zip_of

ScanFile = Callable[[str, bytes | str], Path]
UTM_32 = "EPSG:25832"
PLACE = np.array([640_000.0, 5_320_000.0, 500.0])


def las_of(
    cloud: PointCloud, wkt: str | None = None, keys: list[int] | None = None, minor: int = 4, scale: float = 1.0
) -> bytes:
    """Return a LAZ file that lies at PLACE. keys: of GeoTIFF, four numbers each."""
    file = laspy.create(point_format=7 if minor == 4 else 3, file_version=f"1.{minor}")
    file.header.scales = np.full(3, 0.001)
    file.header.offsets = PLACE * scale
    file.x, file.y, file.z = ((cloud.positions.astype(np.float64) + PLACE) * scale).T
    file.red, file.green, file.blue = cloud.colors.astype(np.uint16).T * 257
    if wkt is not None:
        file.header.vlrs.append(WktCoordinateSystemVlr(wkt))
    if keys is not None:
        directory = GeoKeyDirectoryVlr()
        directory.parse_record_data(np.array([1, 1, 0, len(keys) // 4, *keys], "<u2").tobytes())
        file.header.vlrs.append(directory)
    buffer = io.BytesIO()
    file.write(buffer, do_compress=True)
    return buffer.getvalue()


def notes_of(cloud: PointCloud) -> dict[str, str]:
    return {note.code: note.message for note in cloud.diagnostics}


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        ({"wkt": CRS(UTM_32).to_wkt("WKT1_GDAL")}, UTM_32),
        ({"keys": [1024, 0, 1, 1, 3072, 0, 1, 25832], "minor": 2}, UTM_32),
        ({"keys": [3072, 0, 1, 25832, 4096, 0, 1, 5783], "minor": 2}, "EPSG:5555"),
        ({"keys": [3072, 0, 1, 32767], "minor": 2}, None),
        ({}, None),
    ],
)
def test_a_las_file_names_it_by_wkt_or_by_keys(
    cloud: PointCloud, scan_file: ScanFile, named: dict[str, Any], expected: str | None
) -> None:
    read = read_scan(scan_file("scan.laz", las_of(cloud, **named)))
    assert read.coordinate_system == expected
    np.testing.assert_allclose(read.positions + read.origin_offset, cloud.positions + PLACE, atol=1e-3)
    message = notes_of(read).get("coordinate_system", "")
    assert ("+1.396 degrees clockwise from true north" in message) == (expected is not None)


@pytest.mark.parametrize("text", [CRS(UTM_32).to_wkt(), UTM_32, ""])
def test_an_e57_file_names_it_in_its_root(
    cloud: PointCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    path = tmp_path / "scan.e57"
    # pye57 writes an empty text there, which cannot be changed afterwards.
    made = libe57.StringNode
    monkeypatch.setattr(libe57, "StringNode", lambda image_file, value: made(image_file, value or text))
    file = E57(str(path), mode="w")
    monkeypatch.undo()
    data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), cloud.positions.astype(np.float64).T, strict=True))
    data |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T, strict=True))
    file.write_scan_raw(data, translation=PLACE)
    file.close()
    assert read_scan(path).coordinate_system == (UTM_32 if text else None)


@pytest.mark.parametrize(
    ("wkt", "unit", "up_axis", "scale", "said"),
    [
        (CRS(4326).to_wkt(), "m", "z", 1.0, "no lengths on a grid"),
        ("PROJCS[nonsense", "m", "z", 1.0, "expected a projected coordinate system"),
        (CRS(UTM_32).to_wkt(), "m", "y", 1.0, "the given up axis"),
        (CRS(UTM_32).to_wkt(), "ft", "z", 1 / 0.3048, "its unit is 1 m, but the given unit is ft"),
        (CRS(2263).to_wkt(), "m", "z", 1.0, "its unit is 0.3048006 m, but the given unit is m"),
    ],
)
def test_what_cannot_be_used_is_said_and_the_scan_is_read(
    cloud: PointCloud, scan_file: ScanFile, wkt: str, unit: Unit, up_axis: UpAxis, scale: float, said: str
) -> None:
    path = scan_file("scan.laz", las_of(cloud, wkt, scale=scale))
    read = read_scan(path, ScanOptions(unit=unit, up_axis=up_axis))
    assert read.coordinate_system is None
    assert said in notes_of(read)["coordinate_system_unused"]
    assert len(read) == len(cloud)


def test_scans_of_one_zip_are_in_one_system(cloud: PointCloud, scan_file: ScanFile) -> None:
    one, same = las_of(cloud, CRS(UTM_32).to_wkt()), las_of(cloud, keys=[3072, 0, 1, 25832], minor=2)
    read = read_scan(scan_file("scans.zip", zip_of({"a.laz": one, "b.laz": same})))
    assert read.coordinate_system == UTM_32
    feet = zip_of({name: las_of(cloud, CRS(2263).to_wkt(), scale=3937 / 1200) for name in ("a.laz", "b.laz")})
    assert read_scan(scan_file("feet.zip", feet), ScanOptions(unit="ft")).coordinate_system == "EPSG:2263"
    other = las_of(cloud, CRS("EPSG:25833").to_wkt())
    with pytest.raises(
        ScanContentError, match=r"different coordinate systems \(a\.laz: EPSG:25832, b\.laz: EPSG:25833\)"
    ):
        read_scan(scan_file("scans.zip", zip_of({"a.laz": one, "b.laz": other})))


def test_a_scan_of_a_zip_that_names_no_system_is_said_to_be_in_that_of_the_others(
    cloud: PointCloud, scan_file: ScanFile
) -> None:
    named, silent = las_of(cloud, CRS(25832).to_wkt()), encode_ply(cloud)
    read = read_scan(scan_file("scans.zip", zip_of({"a.ply": silent, "b.laz": named})))
    (said,) = [found for found in read.diagnostics if found.code == "coordinate_system_assumed"]
    assert (read.coordinate_system, said.severity) == ("EPSG:25832", "warning")
    assert said.message.startswith("a.ply has no usable coordinate system")
    alone = read_scan(scan_file("scans.zip", zip_of({"a.laz": named, "b.laz": named})))
    assert "coordinate_system_assumed" not in {found.code for found in alone.diagnostics}
