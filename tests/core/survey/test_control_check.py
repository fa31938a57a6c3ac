"""Maps of known place against control points: residuals, georeferences by fit, and configurations that are refused."""

import math
import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from panoloc.core.earth.geopose import Georeference, earth_pose
from panoloc.core.earth.georeference import ecef_of
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.survey.control_check import ControlCheck, check_control
from panoloc.core.survey.control_csv import ControlPoint

TRUTH = Georeference(48.1371, 11.5754, 562.3, 37.25)
CORNERS = np.array([[0.0, 0, 0.2], [30, 0, 1], [0, 20, 2.5], [30, 20, 6]])
PLUMB = np.array([[5.0, 4, 0.1], [5.02, 4, 2.5], [5, 4.01, 6], [4.99, 4, 9]])
GRID = np.array([691000.0, 5334000.0, 520.0])


def surveyed(positions: NDArray[np.float64], clicked: NDArray[np.float64] | None = None) -> list[ControlPoint]:
    """Return points of a map that stands at TRUTH."""
    places = [earth_pose(TRUTH, Pose(np.eye(3), at)) for at in positions]
    return [
        ControlPoint(f"P{number}", (each.latitude_deg, each.longitude_deg, each.height_m), True, (at[0], at[1], at[2]))
        for number, (each, at) in enumerate(
            zip(places, (positions if clicked is None else clicked).tolist(), strict=True)
        )
    ]


def plain(known: NDArray[np.float64], positions: NDArray[np.float64] = CORNERS) -> list[ControlPoint]:
    return [
        ControlPoint(f"P{number}", (k[0], k[1], k[2]), False, (at[0], at[1], at[2]))
        for number, (k, at) in enumerate(zip(known.tolist(), positions.tolist(), strict=True))
    ]


def checked(
    points: list[ControlPoint], system: str | None = None, undulation_m: float | None = None, **place: Any
) -> ControlCheck:
    return check_control(points, system, undulation_m, place)


@pytest.mark.parametrize("offset", [(0.0, 0, 0), (3000.0, -2000, 50)])
def test_four_points_give_a_map_its_place(offset: tuple[float, float, float]) -> None:
    found = checked(surveyed(CORNERS + offset))
    assert found.fit is not None
    assert found.georeference is not None
    assert np.abs(found.fit.residuals).max() < 1e-6
    assert found.fit.left_out_m.max() < 1e-6
    assert found.georeference.heading_deg == pytest.approx(TRUTH.heading_deg, abs=1e-6)
    there = (found.georeference.latitude_deg, found.georeference.longitude_deg, found.georeference.height_m)
    assert math.dist(ecef_of(*there), ecef_of(TRUTH.latitude_deg, TRUTH.longitude_deg, TRUTH.height_m)) < 1e-4
    assert found.as_is is None


def test_clicks_a_centimetre_off_leave_the_middle_of_the_map_within_two() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        found = checked(surveyed(CORNERS, CORNERS + rng.normal(0, 0.01, CORNERS.shape)))
        assert found.georeference is not None
        middle = Pose(np.eye(3), CORNERS.mean(axis=0))
        places = [earth_pose(each, middle) for each in (found.georeference, TRUTH)]
        ends = [ecef_of(each.latitude_deg, each.longitude_deg, each.height_m) for each in places]
        assert math.dist(*ends) < 0.02


def test_residuals_are_where_the_map_puts_a_point_minus_where_it_is() -> None:
    off = CORNERS + np.array([[0, 0.02, 0], [0, 0, 0], [0, 0, -0.03], [0, 0, 0]])
    found = checked(surveyed(CORNERS, off), georeference=vars(TRUTH))
    assert found.as_is is not None
    turn = math.radians(TRUTH.heading_deg)
    assert found.as_is[0] == pytest.approx([0.02 * math.sin(turn), 0.02 * math.cos(turn), 0], abs=1e-5)
    assert found.as_is[2] == pytest.approx([0, 0, -0.03], abs=1e-5)


def test_a_map_in_a_grid_is_compared_with_the_grid_and_gets_no_georeference() -> None:
    found = checked(plain(CORNERS + GRID, CORNERS + GRID + [0.01, 0, 0]), coordinate_system="EPSG:25832")
    assert found.as_is is not None
    assert np.linalg.norm(found.as_is[:, :2], axis=1) == pytest.approx([0.01] * 4, abs=1e-4)
    assert found.georeference is None
    assert "coordinates of ETRS89 / UTM zone 32N already, so there is nothing to apply" in (found.no_georeference or "")


def test_a_map_in_a_grid_that_is_not_known_is_asked_for_its_coordinate_system() -> None:
    found = checked(plain(CORNERS + GRID, CORNERS + GRID), "EPSG:25832")
    assert (found.georeference, "set the map's coordinate_system" in (found.no_georeference or "")) == (None, True)


def test_grid_coordinates_give_a_georeference_once_the_geoid_is_known() -> None:
    without = checked(plain(CORNERS + GRID), "EPSG:25832+7837")
    assert (without.georeference, "geoid_undulation_m" in (without.no_georeference or "")) == (None, True)
    found = checked(plain(CORNERS + GRID), "EPSG:25832+7837", 46.2)
    assert found.georeference is not None
    assert found.georeference.height_m == pytest.approx(566.2, abs=0.01)


def test_coordinates_of_a_site_are_compared_with_the_map_itself() -> None:
    found = checked(plain(CORNERS + np.array([0, 0, 0.005])))
    assert found.as_is is not None
    assert found.as_is == pytest.approx(np.tile([0, 0, -0.005], (4, 1)), abs=1e-9)
    assert (found.is_on_earth, found.georeference) == (False, None)


def test_coordinates_of_a_grid_without_its_name_are_asked_for_it() -> None:
    found = checked(plain(CORNERS + np.array([691_000.0, 5_334_000.0, 520.0])))
    assert found.fit is not None
    assert found.warnings == (
        "the points lie 5,379 km from where the scan has them: name their coordinate system, or check their unit",
    )


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (plain(CORNERS[:2], CORNERS[:2]), "got 2; click more"),
        (plain(CORNERS[[0, 1, 1]], CORNERS[[0, 1, 2]]), "got P1 and P2 at the same place by their coordinates"),
        (plain(CORNERS * [1, 0, 1], CORNERS * [1, 0, 1]), "in the scan; "),
        (plain(PLUMB, PLUMB), "above each other in the scan, which leave the heading open; add points more than 0.5 m"),
        (plain(PLUMB, CORNERS), "above each other by their coordinates"),
        (plain(CORNERS / 0.3048), "3.281 times those, as if the coordinates were in feet"),
        (plain(CORNERS * 0.001), "as if the positions of the map were in millimetres"),
        (plain(CORNERS * 1.5), "which no unit explains"),
        (plain(CORNERS[:, [1, 0, 2]]), "with x and y exchanged they fit"),
        (plain(np.vstack([CORNERS[:3], [[26, 29, 6]]])), "without P3 the others fit"),
    ],
)
def test_points_that_fix_nothing_are_refused_with_what_is_wrong(points: list[ControlPoint], words: str) -> None:
    found = checked(points)
    assert found.fit is None
    assert re.search(words, found.no_fit or ""), found.no_fit


def test_a_tilted_scan_is_told() -> None:
    turn = math.radians(3)
    tilted = CORNERS @ np.array([[1, 0, 0], [0, math.cos(turn), -math.sin(turn)], [0, math.sin(turn), math.cos(turn)]])
    assert "tilted by 3.0 degrees" in checked(plain(tilted)).warnings[0]


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        ((CORNERS + GRID)[:, [1, 0, 2]], "with x and y exchanged they fit"),
        ((CORNERS + GRID) / 0.3048, "read as feet they fit"),
        ((CORNERS + GRID) * 1000, "read as millimetres they fit"),
    ],
)
def test_coordinates_of_a_grid_that_were_meant_otherwise_are_recognised(sent: NDArray[np.float64], words: str) -> None:
    try:
        told = checked(plain(sent), "EPSG:25832+7837", 46.2).no_fit
    except OptionsError as error:
        told = str(error)
    assert words in (told or ""), told


def test_the_point_without_which_the_others_fit_is_named_and_the_scale_told() -> None:
    house = np.array([[0.0, 0, 0], [20, 0, 1], [0, 20, 2], [20, 20, 3]])
    clicks = np.random.default_rng(5).normal(0, 0.01, house.shape)
    wrong = house + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0.7, 0.7, 0]])
    found = checked(plain(wrong, house + clicks))
    assert re.search(r"^P3 is (0.9|1.0)\d m from where the other points put it", found.warnings[0]), found.warnings
    assert "ppm longer than in the scan" in found.warnings[1]
    assert checked(plain(house, house + clicks)).warnings == ()


def test_a_grossly_wrong_point_is_named_and_none_where_two_are() -> None:
    room = np.array([[7.7, 2.3, 2.4], [0.2, 0.3, 0.1], [5.3, 1.1, 1.4], [6.4, 1.7, 0.6], [5.8, 2.4, 0.4]])
    known = room + np.random.default_rng(2).normal(0, 0.002, room.shape)
    known[4] += [5, 0.6, 3.3]
    assert "without P4 the others fit to 0.00" in (checked(plain(known, room)).no_fit or "")
    known[1] += [-6, 4, 0]
    assert not re.search(r"without P\d", checked(plain(known, room)).no_fit or "without P4")


@pytest.mark.parametrize(("num_points", "click_m"), [(5, 0.01), (8, 0.01), (8, 0.02), (12, 0.02)])
def test_a_point_of_many_that_is_20_cm_off_is_named_and_none_where_all_are_right(
    num_points: int, click_m: float
) -> None:
    rng = np.random.default_rng(num_points)
    named, blamed = 0, 0
    for _ in range(40):
        positions = rng.uniform([0, 0, 0], [20, 15, 6], (num_points, 3))
        known = positions + rng.normal(0, click_m, positions.shape)
        blamed += any("other points put it" in each for each in checked(plain(known, positions)).warnings)
        off = rng.normal(0, 1, 3)
        known[0] += 0.2 * off / np.linalg.norm(off)
        found = checked(plain(known, positions)).warnings
        named += bool(found) and found[0].startswith("P0 is ")
    assert (named >= 36, blamed) == (True, 0), (named, blamed)


def test_points_without_a_place_in_the_scan_are_asked_to_be_clicked() -> None:
    unclicked = [ControlPoint("P1", (691000.0, 5334000.0, 520.0), False, None)]
    found = checked(unclicked, "EPSG:25832", 46.2)
    assert found.no_fit is not None
    assert "click more of them" in found.no_fit
