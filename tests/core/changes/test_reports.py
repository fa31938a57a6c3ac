"""Reports of changes open in what they are for, and say the same."""

import csv
import io
import json
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from panoloc.core.changes.reports.__main__ import main
from panoloc.core.changes.reports.report import ChangeReport
from panoloc.core.changes.reports.web_page import as_html
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud

GRID = np.array([691_600.0, 5_334_800.0, 500.0])
"""In EPSG:25832, in Munich."""


WGS84 = {"latitude_deg": 48.139, "longitude_deg": 11.585, "height_m": 545.5, "height_reference": "ellipsoid"}


def beside(x: float, y: float, z: float) -> list[float]:
    """Return a place near the corner of the room."""
    return list((GRID + np.array([x, y, z])).tolist())


def grid(position_m: list[float]) -> dict[str, Any]:
    east, north, height_m = position_m
    return {"name": "ETRS89 / UTM zone 32N", "unit": "m", "east": east, "north": north, "height_m": height_m}


def changed(number: int, kind: str, **others: Any) -> dict[str, Any]:
    return {
        "id": f"{number:012x}",
        "kind": kind,
        "center_m": beside(number, 1.0, 0.5),
        "size_m": [0.6, 0.5, 1.0],
        "from_m": None,
        "floor": 0,
        "seen_from_m": beside(0, 0, 1.5),
        "certainty": 0.8,
        "is_sure": True,
        "num_photos": 2,
        "first_seen_at": "2026-11-21T12:00:00Z",
        "last_seen_at": "2026-11-21T12:00:00Z",
        "grid": grid(beside(number, 1.0, 0.5)),
        "from_grid": None,
        "wgs84": WGS84,
        **others,
    }


OBJECTS = [
    changed(1, "came"),
    changed(2, "went"),
    changed(3, "moved", from_m=beside(0.5, 2.0, 0.5), from_grid=grid(beside(0.5, 2.0, 0.5))),
    changed(4, "came", certainty=0.4, is_sure=False),
]


def report(folder: Path, wanted: str, num_photos: int = 3, **others: Any) -> bytes:
    """Return a report of four changes, of which one is unsure, in a room of 4 m; without photos of none. others: of each change."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 4, (4000, 3)).astype(np.float32) * (1, 1, 0.6)
    cloud = PointCloud(points.astype(np.float32), rng.integers(0, 255, (4000, 3), dtype=np.uint8), origin_offset=GRID)
    write_ply(folder / "points.ply", cloud)
    with zipfile.ZipFile(folder / "found.zip", "w") as archive:
        for each in OBJECTS:
            picture = io.BytesIO()
            Image.new("RGB", (64, 32), "red").save(picture, "JPEG")
            archive.writestr(f"{each['id']}.jpg", picture.getvalue())
    about = {
        "title": "Büro <3> 東",
        "num_photos": num_photos,
        "period": "Found in 3 photos.",
        "made_at": "2026-11-22T08:00:00Z",
    }
    sources = {
        "points": str(folder / "points.ply"),
        "found": str(folder / "found.zip"),
        "objects": [each | others for each in OBJECTS] if num_photos else [],
    }
    (folder / "document.json").write_text(json.dumps({**about, **sources}))
    assert main([str(folder / "document.json"), wanted, str(folder / "out")]) == 0
    return (folder / "out").read_bytes()


def test_the_page_stands_alone_and_escapes_names(tmp_path: Path) -> None:
    page = report(tmp_path, "html").decode()
    assert "Büro &lt;3&gt; 東" in page
    assert "1 came, 1 went, 1 moved; 1 unsure" in page
    assert page.count(">came?<") == 2  # in the list, and beside its picture
    assert page.count("data:image/jpeg") == len(OBJECTS)
    assert page.count('<td class="n">1</td>') == len(OBJECTS)  # the lowest floor, as on the console's plan
    assert "http" not in page
    assert "<script" not in page


def test_without_photos_no_report_says_that_nothing_changed(tmp_path: Path) -> None:
    page = report(tmp_path, "html", num_photos=0).decode()
    assert "there were no photos" in page
    assert "changed for sure" not in page
    assert "No change" not in page
    assert report(tmp_path, "pdf", num_photos=0).startswith(b"%PDF")


def test_the_pdf_has_plan_list_and_pictures_and_takes_any_name(tmp_path: Path) -> None:
    data = report(tmp_path, "pdf")
    assert data.startswith(b"%PDF-")
    assert data.count(b"/Subtype /Image") >= 2


def test_a_spreadsheet_has_one_line_per_object_in_metres(tmp_path: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(report(tmp_path, "csv").decode())))
    assert [row["kind"] for row in rows] == ["came", "went", "moved", "came"]
    assert [row["is_sure"] for row in rows] == ["1", "1", "1", "0"]
    assert float(rows[0]["x_m"]) == pytest.approx(691_601.0)
    assert rows[0]["from_x_m"] == ""
    assert float(rows[2]["from_x_m"]) == pytest.approx(691_600.5)
    assert (rows[0]["grid"], rows[0]["grid_unit"], rows[0]["from_grid_east"]) == ("ETRS89 / UTM zone 32N", "m", "")
    assert float(rows[0]["grid_north"]) == pytest.approx(5_334_801.0)
    assert float(rows[2]["from_grid_height_m"]) == pytest.approx(500.5)


@pytest.mark.parametrize(("height_m", "told"), [(20.0, ", H 20.00 m"), (None, "")])
def test_a_grid_other_than_the_frame_of_the_map_is_told_beside_it(height_m: float | None, told: str) -> None:
    feet = {"name": "California <6>", "unit": "ftUS", "east": 6.3e6, "north": 2e6, "height_m": height_m}
    page = as_html(ChangeReport("", 1, "", "", [OBJECTS[2] | {"grid": feet}], {}, b"")).decode()
    assert f"500.50<br>E 6300000.00, N 2000000.00 ftUS{told}<br>from 691600.50" in page
    assert "Its grid is California &lt;6&gt;." in page
    assert page.count("<br>") == 2  # where it was before, frame and grid are the same


def test_geojson_is_in_degrees_on_earth_and_says_so_where_it_is_not(tmp_path: Path) -> None:
    placed = json.loads(report(tmp_path, "geojson"))
    assert placed["features"][0]["geometry"]["coordinates"] == [11.585, 48.139, 545.5]
    assert placed["features"][0]["properties"]["grid"]["east"] == 691_601.0
    unplaced = json.loads(report(tmp_path, "geojson", wgs84=None))
    assert unplaced["features"][0]["geometry"]["coordinates"] == OBJECTS[0]["center_m"]
    assert "metres" in unplaced["crs_note"]
    assert "crs_note" not in placed


def test_bcf_has_a_topic_with_viewpoint_and_snapshot_per_object(tmp_path: Path) -> None:
    with zipfile.ZipFile(io.BytesIO(report(tmp_path, "bcf"))) as archive:
        assert ElementTree.fromstring(archive.read("bcf.version")).get("VersionId") == "2.1"
        topics = {name.partition("/")[0] for name in archive.namelist() if "/" in name}
        assert len(topics) == len(OBJECTS)
        for topic in topics:
            markup = ElementTree.fromstring(archive.read(f"{topic}/markup.bcf"))
            view = ElementTree.fromstring(archive.read(f"{topic}/viewpoint.bcfv"))
            assert markup.find("Topic").get("Guid") == topic  # type: ignore[union-attr]
            assert markup.find("Viewpoints").get("Guid") == view.get("Guid")  # type: ignore[union-attr]
            direction = [float(value.text or "") for value in view.find("PerspectiveCamera/CameraDirection") or ()]
            assert np.linalg.norm(direction) == pytest.approx(1.0, abs=1e-5)
            assert Image.open(io.BytesIO(archive.read(f"{topic}/snapshot.png"))).format == "PNG"
