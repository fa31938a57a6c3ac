"""Pictures of a placement: dots where photos were taken, and every photo with what became of it."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from panoloc.core.exports.overview import (
    COLOR_OF,
    PAPER,
    PhotoSeen,
    Placement,
    draw_contact_sheet,
    draw_plan,
    font_of,
    legible,
    main,
    read_placement,
    shortened,
)
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.exports.tours import jpeg, rotation_of
from tests.core.image.picture_files import heic

LARGE = np.array([431_250.0, 5_312_480.0, 412.0])


def taken_at(x: float, y: float, heading_deg: float = 0.0) -> Pose:
    return Pose(rotation_of(heading_deg, 0, 0), np.array([x, y, 1.5]))


def has_color(picture: np.ndarray, column: float, row: float, color: tuple[int, int, int]) -> bool:
    return bool(np.array_equal(picture[round(row), round(column)], color))


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Return a floor of 10 m by 5 m with a ceiling over it."""
    x, y = np.meshgrid(np.linspace(0, 10, 400), np.linspace(0, 5, 200))
    floor = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    positions = np.vstack([floor, floor + np.array([0, 0, 3])]).astype(np.float32)
    colors = np.repeat(np.array([[150, 120, 90], [5, 5, 5]], np.uint8), x.size, axis=0)
    path = tmp_path / "points.ply"
    write_ply(path, PointCloud(positions, colors, np.zeros(3)))
    return path


def test_a_photo_is_a_dot_where_it_was_taken_with_an_arrow_where_it_looks(scan: Path) -> None:
    photos = (
        PhotoSeen(1, "a.jpg", "localized", 0.9, (taken_at(2.5, 2.5, 270),), None),
        PhotoSeen(2, "b.jpg", "ambiguous", 0.4, (taken_at(7.5, 1.0), taken_at(7.5, 4.0)), None),
        PhotoSeen(3, "c.jpg", "not_localized", 0.1, (), None),
    )
    picture = draw_plan(Placement("map_1", photos, scan))
    scale = 1200 / 10
    height = 598  # a point is two pixels high
    assert picture.shape[1] == pytest.approx(1200, abs=4)
    blue, orange = COLOR_OF["localized"], COLOR_OF["ambiguous"]
    at = 2.5 * scale, height - 2.5 * scale
    assert has_color(picture, *at, blue)
    assert has_color(picture, at[0] - 18, at[1], blue)  # looks against x, to the left
    assert not has_color(picture, at[0] + 18, at[1], blue)
    likeliest, other = (7.5 * scale, height - 1.0 * scale), (7.5 * scale, height - 4.0 * scale)
    assert has_color(picture, likeliest[0], likeliest[1] + 3, orange)
    assert has_color(picture, other[0] + 3, other[1] + 3, PAPER)
    assert has_color(picture, other[0], other[1] - 18, orange)  # looks north, up
    floor, ceiling = ((picture[:600] == color).all(axis=2).mean() for color in ((150, 120, 90), (5, 5, 5)))
    assert floor > 0.4  # there are fewer points than pixels
    assert ceiling == 0


def test_a_plan_of_a_national_grid_and_one_without_points_have_their_photos(tmp_path: Path) -> None:
    far = tuple(
        PhotoSeen(number, "a.jpg", "localized", 0.9, (Pose(np.eye(3), LARGE + np.array([number, 0, 0])),), None)
        for number in (1, 2)
    )
    for placement in (Placement("map_1", far, None), Placement("map_1", (), None)):
        picture = draw_plan(placement)
        assert (picture == COLOR_OF["localized"]).all(axis=2).sum() >= 100 * len(placement.photos)


@pytest.mark.slow
def test_the_contact_sheet_has_every_photo_and_an_empty_place_for_what_does_not_decode(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(640, 320))
    (tmp_path / "b.jpg").write_bytes(b"no photo")
    Image.new("RGBA", (50, 200), (10, 200, 10, 255)).save(tmp_path / "c.png")
    photos = (
        PhotoSeen(1, "a.jpg", "localized", 0.9, (), tmp_path / "a.jpg"),
        PhotoSeen(2, "b.jpg", "failed", None, (), tmp_path / "b.jpg"),
        PhotoSeen(3, "c.png", "not_localized", 0.2, (), tmp_path / "c.png"),
        PhotoSeen(4, "d.jpg", "waiting", None, (), None),
    )
    sheet = draw_contact_sheet(Placement("map_1", photos, None))
    for photo in photos:
        assert (sheet == COLOR_OF[photo.status]).all(axis=2).sum() > 2000
    assert (sheet == (10, 200, 10)).all(axis=2).sum() == pytest.approx(40 * 160, rel=0.1)
    many = tuple(PhotoSeen(number, "x.jpg", "waiting", None, (), None) for number in range(2000))
    height, width = draw_contact_sheet(Placement("map_1", many, None)).shape[:2]
    assert max(height, width) < 10_000


def test_of_long_names_the_end_is_shown() -> None:
    font = font_of(16)
    assert shortened("hall.jpg", font, 500) == "hall.jpg"
    short = shortened("x" * 100 + "/hall_0001.jpg", font, 120)
    assert short.startswith("...")
    assert short.endswith("0001.jpg")
    assert font.getlength(short) <= 120


def test_pictures_are_drawn_of_a_document(tmp_path: Path, scan: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg())
    pose = {"frame": "webxr", "position_m": [2.0, 1.5, -1.0], "quaternion_xyzw": [0, 0, 0, 1]}
    photo = {
        "name": "a.jpg",
        "image": str(tmp_path / "a.jpg"),
        "status": "localized",
        "confidence": 0.9,
        "poses": [pose],
    }
    document = tmp_path / "placement.json"
    document.write_text(json.dumps({"map": "map_1", "scan": str(scan), "photos": [photo]}))
    (seen,) = read_placement(document).photos
    assert np.allclose(seen.poses[0].position, [2, 1, 1.5])
    targets = [tmp_path / "plan.png", tmp_path / "contact-sheet.jpg"]
    assert main([str(document), *map(str, targets)]) == 0
    for target, kind in zip(targets, ("PNG", "JPEG"), strict=True):
        with Image.open(target) as image:
            assert image.format == kind


def test_letters_of_many_languages_are_drawn_and_those_of_no_font_are_question_marks() -> None:
    font = font_of(16)
    assert legible("Küche Кухня Κουζίνα.jpg", font) == "Küche Кухня Κουζίνα.jpg"
    assert legible("Ku\u0308che.jpg", font) == "Küche.jpg"  # as macOS writes it
    assert legible("厨房 1.jpg", font) == "?? 1.jpg"
    assert legible("new\nline.jpg", font) == "new?line.jpg"


def test_a_photo_in_heic_is_on_the_sheet(tmp_path: Path) -> None:
    photo = tmp_path / "00000"
    photo.write_bytes(heic(np.full((64, 128, 3), (0, 200, 0), np.uint8)))
    sheet = draw_contact_sheet(Placement("map_1", (PhotoSeen(1, "a.heic", "localized", 0.9, (), photo),), None))
    assert (np.abs(sheet.astype(int) - (0, 200, 0)).max(axis=2) < 8).sum() > 1000
