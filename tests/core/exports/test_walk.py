"""What the page of a walk-through is told, and the photos beside it."""

import base64
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.formats import export
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.ply.writer import write_ply
from panoloc.core.scan.point_cloud import PointCloud
from tests.core.exports.tours import LARGE, WALK_PAGE, golden_tour, jpeg, written

GPS, MAKER = 0x8825, 0x010F


def data_of(folder: Path) -> Any:
    return json.loads((folder / "walk" / "data.js").read_text().removeprefix("window.panolocWalk = ").rstrip(";\n"))


def picture_of(script: Path) -> Image.Image:
    """Return the picture that a script hands over."""
    found = re.fullmatch(r'panolocPhoto\("([\w-]+)", "data:image/jpeg;base64,([\w+/=]+)"\);\n', script.read_text())
    assert found is not None
    assert found[1] == script.stem
    return Image.open(io.BytesIO(base64.b64decode(found[2])))


def house(folder: Path) -> Tour:
    """Return photos in two rooms with a wall and a door between them, and one on the floor above; far from the origin."""
    (folder / "a.jpg").write_bytes(jpeg())
    y, z = (each.ravel() for each in np.meshgrid(np.arange(0, 4, 0.03), np.arange(0, 2.5, 0.03)))
    keep = ~((y > 1.5) & (y < 2.5) & (z < 2.1))
    wall = np.stack([np.full(keep.sum(), 2.0), y[keep], z[keep]], axis=1)
    x, y = (each.ravel() for each in np.meshgrid(np.arange(0, 4, 0.03), np.arange(0, 4, 0.03)))
    slab = np.stack([x, y, np.full(len(x), 2.7)], axis=1)
    points = np.concatenate([wall, slab]).astype(np.float32)
    write_ply(folder / "scan.ply", PointCloud(points, np.full((len(points), 3), 90, np.uint8), origin_offset=LARGE))
    places = {
        "west": (1, 0.6, 1.5),
        "door": (1.7, 2, 1.5),
        "east": (3, 2.3, 1.5),
        "corner": (3, 0.6, 1.5),
        "above": (1, 2, 4.3),
    }
    photos = tuple(
        PlacedPhoto(f"{name}.jpg", Pose(np.eye(3), LARGE + place), 64, 32, image=folder / "a.jpg")
        for name, place in places.items()
    )
    levels = float(LARGE[2]), float(LARGE[2]) + 2.8
    return Tour("map_1", photos, scan=folder / "scan.ply", floor_levels_m=levels, title="A <house>", page=WALK_PAGE)


def test_links_go_through_doors_and_not_through_walls_and_each_photo_has_its_floor(tmp_path: Path) -> None:
    data = data_of(written("tour", house(tmp_path), tmp_path / "out"))
    west, door, east, corner, above = data["photos"]
    assert data["title"] == "A <house>"
    assert west["links"][0] == 1
    assert 3 not in west["links"]
    assert 2 in door["links"]
    assert 3 in east["links"]
    assert [photo["floor"] for photo in data["photos"]] == [0, 0, 0, 0, 1]
    assert above["links"]  # nobody is left behind
    assert all(2 <= floor["width"] <= 7 for floor in data["floors"])
    levels = [floor["level"] + data["origin"][2] - LARGE[2] for floor in data["floors"]]
    np.testing.assert_allclose(levels, [0, 2.8], atol=1e-9)
    assert np.abs(corner["position"]).max() < 10


def test_a_floor_is_seen_from_under_its_ceiling(tmp_path: Path) -> None:
    out = written("tour", house(tmp_path), tmp_path / "out")
    floor = data_of(out)["floors"][0]
    with Image.open(out / floor["plan"]) as picture:
        shown = np.asarray(picture)[..., 3] > 0
    # Of the ground floor only the wall was scanned; the slab above it would hide that.
    assert 0 < shown.mean() < 0.1


def test_photos_come_in_sizes_that_their_pixels_allow_upright_and_without_where_they_were_taken(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[MAKER], exif[0x0112] = "maker", 6  # lies on its side
    exif.get_ifd(GPS)[1] = "N"
    Image.new("RGB", (2400, 3600), (200, 30, 30)).save(tmp_path / "phone.jpg", exif=exif)
    photo = PlacedPhoto(
        "phone.jpg", Pose(np.eye(3), np.zeros(3)), 3600, 2400, is_sphere=False, camera_model="pinhole", hfov_deg=69.0,
        image=tmp_path / "phone.jpg",
    )  # fmt: skip
    tour = golden_tour(tmp_path)
    out = written("tour", replace(tour, photos=(*tour.photos, photo)), tmp_path / "out")
    small, photo_data = data_of(out)["photos"]
    assert (photo_data["model"], photo_data["hfovDeg"], photo_data["hasLarge"]) == ("pinhole", 69.0, True)
    assert (small["taken"], photo_data["taken"]) == ("2025-06-26", None)
    photos = out / "walk" / "photos"
    assert picture_of(photos / "1-large.js").size == (3600, 2400)
    assert picture_of(photos / "1-medium.js").size == (2048, 1365)
    with Image.open(photos / "1-small.jpg") as thumbnail:
        assert thumbnail.size == (320, 213)
    assert not any(picture_of(each).getexif() for each in photos.glob("*.js"))
    assert b"maker" not in (photos / "1-small.jpg").read_bytes()
    # A photo with fewer pixels is not enlarged, and comes in no third size.
    assert picture_of(photos / "0-medium.js").size == (64, 32)
    assert not (photos / "0-large.js").exists()


def test_without_a_built_page_the_export_says_how_to_build_it(tmp_path: Path) -> None:
    for page in (None, tmp_path):
        with pytest.raises(ExportRefusedError, match="scripts/build-console"):
            list(export("tour", replace(golden_tour(tmp_path), page=page)))
