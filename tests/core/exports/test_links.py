"""Links of a tour follow lines of sight in the scan, few of them, and reach every photo."""

import numpy as np
import pytest

from panoloc.core.exports.links import links_of
from panoloc.lab.rooms.capture.free_space import free_position
from panoloc.lab.rooms.capture.scanning import scan_scene
from panoloc.lab.rooms.scenes.generator import SceneSpec, build_scene

HEIGHT_M = 2.6
LARGE = np.array([431_250.25, 5_312_480.5, 412.75])
DENSITY = 900  # points per square metre: 3 cm apart


def wall(
    start: tuple[float, float], end: tuple[float, float], above_m: float = 0.0, top_m: float = HEIGHT_M
) -> np.ndarray:
    """Return random points of an upright wall with a rough face."""
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    random = np.random.default_rng(round(1000 * (start[0] + 7 * end[1] + length)))
    along, up = random.random((2, round(length * (top_m - above_m) * DENSITY)))
    at = np.array(start) + along[:, None] * (np.array(end) - np.array(start))
    points = np.column_stack([at, above_m + up * (top_m - above_m)])
    return np.asarray(points + random.normal(scale=0.005, size=points.shape))


def floor(level_m: float) -> np.ndarray:
    random = np.random.default_rng(9)
    return np.column_stack(
        [random.random((round(12 * 5 * DENSITY), 2)) * (12, 5), np.full(round(12 * 5 * DENSITY), level_m)]
    )


def rooms(door: bool = True) -> np.ndarray:
    """Return two rooms, x from 0 to 6 and from 6 to 12, y from 0 to 5, with a door of 0.9 m in the wall between them."""
    sides = [wall((0, 0), (12, 0)), wall((12, 0), (12, 5)), wall((12, 5), (0, 5)), wall((0, 5), (0, 0))]
    middle = [wall((6, 0), (6, 2)), wall((6, 2.9), (6, 5)), wall((6, 2), (6, 2.9), above_m=2.0)]
    if not door:
        middle.append(wall((6, 2), (6, 2.9), top_m=2.0))
    return np.vstack([*sides, *middle, floor(0), floor(HEIGHT_M)])


def photos(*places: tuple[float, float]) -> np.ndarray:
    return np.array([(x, y, 1.6) for x, y in places])


LEFT_BACK, LEFT_DOOR, RIGHT_DOOR, RIGHT_BACK = (1, 4.5), (5, 2.4), (7, 2.5), (11, 4.5)


@pytest.mark.parametrize("offset", [np.zeros(3), LARGE], ids=["near", "survey"])
def test_photos_are_linked_through_a_door_and_not_through_the_wall_beside_it(offset: np.ndarray) -> None:
    places = photos(LEFT_BACK, LEFT_DOOR, RIGHT_DOOR, RIGHT_BACK, (5.5, 4.5), (6.5, 4.5))
    found = links_of(places + offset, rooms() + offset)
    assert 5 not in found[4]  # a metre apart, but the wall is between them
    assert 2 in found[1]
    assert found[5] == [2]  # which is nearer to photo 3
    for number, linked in enumerate(found):
        assert all(number in found[other] for other in linked)


def test_a_photo_between_two_others_is_the_way_from_one_to_the_other() -> None:
    corridor = photos(*((x, 1.0) for x in (0.5, 2.0, 3.5, 5.0)))
    assert links_of(corridor, rooms()) == [[1], [0, 2], [1, 3], [2]]


def test_links_of_a_room_full_of_photos_lie_far_apart() -> None:
    random = np.random.default_rng(4)
    places = photos(*random.uniform((0.5, 0.5), (5.5, 4.5), (25, 2)))
    for number, linked in enumerate(links_of(places, rooms())):
        assert 1 <= len(linked) <= 5
        ahead = places[linked] - places[number]
        ahead /= np.linalg.norm(ahead, axis=1)[:, None]
        cosines = ahead @ ahead.T - 2 * np.eye(len(ahead))
        assert cosines.max() < np.cos(np.radians(59))


def test_what_no_line_of_sight_reaches_is_joined_by_the_shortest_link() -> None:
    places = photos(LEFT_BACK, LEFT_DOOR, RIGHT_DOOR, RIGHT_BACK)
    upstairs = np.vstack([places, places[1] + (0, 0, HEIGHT_M), places[3] + (0, 0, HEIGHT_M + 0.1)])
    storeys = np.vstack([rooms(door=False), rooms() + np.array([0, 0, HEIGHT_M])])
    found = links_of(upstairs, storeys)
    assert found == [[1], [2, 4, 0], [1, 3], [2], [1, 5], [4]]  # a closed door, and one way up


def test_without_points_the_nearest_photos_are_linked() -> None:
    assert links_of(photos((0, 0), (2, 0), (4, 0)), np.zeros((0, 3))) == [[1], [0, 2], [1]]
    assert links_of(photos((0, 0), (5e6, 0), (5e6, 2)), rooms()) == [[1], [2, 0], [1]]
    assert links_of(np.zeros((0, 3)), np.zeros((0, 3))) == []
    assert links_of(photos((0, 0)), rooms()) == [[]]
    assert links_of(photos((0, 0), (0, 0)), rooms()) == [[1], [0]]


def test_a_thinned_scan_of_a_large_building_still_has_walls_and_doors() -> None:
    random = np.random.default_rng(6)
    points = rooms()
    thin = random.choice(len(points), len(points) // 12, replace=False)  # 75 per square metre: 12 cm apart
    places = photos(LEFT_BACK, LEFT_DOOR, RIGHT_DOOR, RIGHT_BACK, (5.5, 4.5), (6.5, 4.5))
    found = links_of(places, points[thin])
    assert 5 not in found[4]
    assert 2 in found[1]


@pytest.mark.slow
def test_no_link_of_a_furnished_flat_leads_through_its_walls_where_another_way_is_seen() -> None:
    """The flat itself says which photos see each other; its scan is noisy and has holes behind furniture."""
    scene, random = build_scene(SceneSpec("flat", 7102)), np.random.default_rng(7102)
    places = np.array([free_position(scene, random) for _ in range(16)])
    cloud = scan_scene(scene, seed=7102)
    found = links_of(places, cloud.positions.astype(np.float64))
    links = [(one, other) for one, linked in enumerate(found) for other in linked if one < other]
    pairs = np.array(links)
    blocked = scene.surface.blocked(places[pairs[:, 0]], places[pairs[:, 1]])
    # Without a link through a wall, or between two parts that see nothing of each other, the tour would fall apart.
    for pair in pairs[blocked].tolist():
        rest = [other for other in links if list(other) != pair]
        assert len(reached(rest)) < len(places), pair
    assert blocked.sum() <= len(pairs) / 4


def reached(links: list[tuple[int, int]]) -> set[int]:
    found, grown = {0}, True
    while grown:
        more = {end for link in links for end in link if found & set(link)}
        grown = not more <= found
        found |= more
    return found
