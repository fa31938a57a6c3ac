"""Unit, heights and up axis of scans that do not say them: found, asked for, or as they were given."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

from panoloc.core.exports.floor_plan import points_of
from panoloc.core.exports.tour import Tour
from panoloc.core.options import METRES_PER_UNIT, ScanOptions, Unit, UpAxis
from panoloc.core.scan.doubts import Seen, ask_up_axis
from panoloc.core.scan.frame import ReadAs, ScanFrame
from panoloc.core.scan.gravity import AxisLook
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.core.scan.point_cloud import Diagnostic, PointCloud
from panoloc.core.scan.reading import read_points_of_map, read_scan
from panoloc.core.scan.reading_context import ReadingContext
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene
from tests.core.scan.scan_files import las_of, read


@cache
def room(kind: str = "room", seed: int = 205) -> PointCloud:
    return scan_scene(build_scene(SceneSpec(kind, seed)), num_points=40_000, seed=seed)  # type: ignore[arg-type]


def file_of(cloud: PointCloud, unit: Unit = "m", up_axis: UpAxis = "z", height_unit: Unit | None = None) -> bytes:
    """Return a PLY file of a cloud in another unit and with another axis up."""
    frame = ScanFrame(METRES_PER_UNIT[unit], METRES_PER_UNIT[height_unit or unit], up_axis)
    back = np.linalg.inv(frame.to_map(np.eye(3)))
    return encode_ply(replace(cloud, positions=(cloud.positions @ back).astype(np.float32)))


def questions_of(cloud: PointCloud) -> list[Diagnostic]:
    return [each for each in cloud.diagnostics if each.question]


def assert_found(found: PointCloud, cloud: PointCloud) -> None:
    np.testing.assert_allclose(found.positions + found.origin_offset, cloud.positions, atol=1e-3)


@pytest.mark.parametrize(
    ("unit", "up_axis"), [("m", "z"), ("cm", "z"), ("mm", "y"), ("ft", "z"), ("m", "-y"), ("m", "-z"), ("ft", "y")]
)
def test_a_furnished_room_shows_its_unit_and_what_is_up(unit: Unit, up_axis: UpAxis) -> None:
    found = read("scan.ply", file_of(room(), unit, up_axis))
    assert questions_of(found) == []
    assert_found(found, room())
    assert found.read_as is not None
    assert (found.read_as.unit, found.read_as.up_axis) == (unit, up_axis)
    if up_axis == "z" and unit == "m":
        assert found.positions.tobytes() == room().positions.tobytes()


def test_heights_in_feet_over_a_grid_in_metres_are_asked_about_and_an_answer_mends_them() -> None:
    positions = room().positions.astype(np.float64) * [1, 1, 1 / METRES_PER_UNIT["us-ft"]]
    place = np.array([640_000.0, 5_320_000.0, 0.0])
    cloud = replace(room(), positions=positions.astype(np.float32), origin_offset=place)
    scan = las_of(cloud, 7, vlrs=(WktCoordinateSystemVlr(CRS(25832).to_wkt()),), minor=4)
    (asked,) = questions_of(read("scan.laz", scan))
    assert (asked.code, asked.severity) == ("heights_doubtful", "warning")
    assert asked.question is not None
    patches = {choice["label"]: choice["patch"] for choice in asked.question["choices"]}
    assert set(patches) == {"as it is", "all in feet", "heights in feet"}
    mended = read("scan.laz", scan, **patches["heights in feet"])
    assert questions_of(mended) == []
    np.testing.assert_allclose(np.ptp(mended.positions, axis=0), np.ptp(room().positions, axis=0), atol=2e-3)
    # A hall that is so high stays so when that is given.
    kept = read("scan.laz", scan, **patches["as it is"])
    assert np.ptp(kept.positions[:, 2]) == pytest.approx(np.ptp(positions[:, 2]), abs=2e-3)


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_an_empty_room_upside_down_is_asked_about_and_each_choice_says_what_it_leads_to(unit: Unit) -> None:
    (asked,) = questions_of(read("scan.ply", file_of(room("bare", 207), unit, "-z")))
    assert asked.code == "up_axis_doubtful"
    assert asked.question is not None
    choices = {choice["label"]: choice for choice in asked.question["choices"]}
    height = float(np.quantile(room("bare", 207).positions[:, 2], 0.99))
    assert choices["-z up"]["patch"] == {"up_axis": "-z"}
    assert choices["-z up"]["storey_height_m"] == pytest.approx(height, abs=0.1)
    assert choices["y up"]["extent_m"][2] == pytest.approx(float(np.ptp(room("bare", 207).positions[:, 1])), abs=0.01)
    assert_found(read("scan.ply", file_of(room("bare", 207), unit, "-z"), up_axis="-z"), room("bare", 207))


@pytest.mark.parametrize(
    ("options", "code"), [({"unit": "m"}, "unit_doubtful"), ({"up_axis": "z"}, "up_axis_doubtful"), ({}, None)]
)
def test_what_is_given_wins_and_a_contradiction_is_asked_about(options: dict[str, Any], code: str | None) -> None:
    found = read("scan.ply", file_of(room(), "mm", "-z"), **options)
    assert found.read_as is not None
    asked = {each.code: each.question["choices"] for each in questions_of(found) if each.question is not None}
    assert (code in asked) if code else (asked == {})
    for field, value in options.items():
        assert getattr(found.read_as, field) == value
        # To confirm it is a choice as well.
        assert any(choice["patch"].get(field) == value for choice in asked[code or ""])


def test_a_given_axis_is_a_choice_also_where_no_storey_is_seen_along_it() -> None:
    context = ReadingContext(Path("scan.ply"), ScanOptions(up_axis="x"), 0)
    seen = Seen(room().positions.astype(np.float64), [AxisLook(0.0, 0.0, None)] * 3, 2)
    ask_up_axis(context, ReadAs("m", "m", "x", "file", "file", "given"), seen, "-y", True, 1.0)
    (asked,) = context.diagnostics
    assert asked.question is not None
    assert "-y points up; x was given" in asked.message
    assert {choice["patch"]["up_axis"] for choice in asked.question["choices"]} == {"z", "-y", "x"}


def test_a_given_unit_that_makes_a_toy_of_a_room_is_asked_about() -> None:
    (asked,) = questions_of(read("scan.ply", file_of(room()), unit="mm"))
    assert asked.question is not None
    sides = {choice["patch"]["unit"]: choice["extent_m"][0] for choice in asked.question["choices"]}
    assert "mm" not in sides
    assert sides["m"] == pytest.approx(float(np.ptp(room().positions[:, 0])), abs=0.01)
    assert questions_of(read("scan.ply", file_of(room()), unit="m")) == []


def test_far_from_the_origin_it_is_asked_which_feet() -> None:
    cloud = replace(room(), origin_offset=np.array([1_900_000.0, 560_000.0, 0.0]))
    feet = replace(
        cloud, positions=(cloud.positions / 0.3048).astype(np.float32), origin_offset=cloud.origin_offset / 0.3048
    )
    (asked,) = questions_of(read("scan.ply", encode_ply(feet)))
    assert asked.question is not None
    assert [choice["patch"]["unit"] for choice in asked.question["choices"]] == ["ft", "us-ft"]


def test_a_place_without_rooms_is_taken_in_metres_and_asked_about() -> None:
    open_place = room().positions[room().positions[:, 2] < 1.5]
    found = read("scan.ply", encode_ply(replace(room(), positions=open_place, colors=room().colors[: len(open_place)])))
    assert found.read_as is not None
    assert (found.read_as.unit, found.read_as.unit_from, found.read_as.up_axis) == ("m", "assumed", "z")
    (asked,) = questions_of(found)
    assert asked.question is not None
    sides = {choice["patch"]["unit"]: choice["extent_m"][0] for choice in asked.question["choices"]}
    assert sides["ft"] == pytest.approx(0.3048 * sides["m"], abs=0.002)


def test_the_points_of_a_map_are_not_judged_again(tmp_path: Path) -> None:
    hall = replace(room(), positions=room().positions / np.float32(METRES_PER_UNIT["ft"]))
    path = tmp_path / "points.ply"
    path.write_bytes(encode_ply(hall))
    assert_found(read_scan(path), room())  # as large as that, it seems to be in feet
    assert_found(read_points_of_map(path), hall)
    drawn = points_of(Tour("map_1", (), scan=path)).positions
    np.testing.assert_allclose(drawn, hall.positions, atol=1e-3)
