"""A point of the map lands on its pixel by the projection of each target itself."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from PIL import Image

from panoloc.core.exports.colmap import FACES, cut_face, face_size, turned
from panoloc.core.exports.tour import PlacedPhoto, Tour
from panoloc.core.geometry.pose import Pose
from tests.core.exports.readers import GL
from tests.core.exports.tours import GOLDEN, HEIGHT, PIXEL, POINT, WIDTH, document_of, golden_tour, written


def test_colmap_projects_a_point_of_the_map_to_its_pixel(tmp_path: Path) -> None:
    model = pycolmap.Reconstruction(written("colmap", golden_tour(), tmp_path))
    image: Any = model.images[1]
    assert image.camera.model.name == "EQUIRECTANGULAR"
    np.testing.assert_allclose(image.project_point(POINT), PIXEL, atol=1e-5)


@pytest.mark.slow
def test_the_rig_of_colmap_sees_a_point_in_its_front_face_alone(tmp_path: Path) -> None:
    golden = golden_tour(tmp_path)
    folder = written("colmap-rig", golden, tmp_path / "out")
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    size = face_size(golden.photos[0])
    seen = {}
    for image in model.images.values():
        pixel = image.project_point(POINT)
        if pixel is not None and (pixel >= 0).all() and (pixel <= size).all():
            seen[image.name] = pixel
        np.testing.assert_allclose(image.projection_center(), GOLDEN.position, atol=1e-9)
    x, y, z = GOLDEN.inverse().rotation @ (POINT - GOLDEN.position)
    expected = size / 2 * np.array([1 - y / x, 1 - z / x])
    assert list(seen) == ["front/pano_jpg.jpg"]
    np.testing.assert_allclose(seen["front/pano_jpg.jpg"], expected, atol=1e-6)
    (rig,) = model.rigs.values()
    assert rig.num_sensors() == 6
    (frame,) = model.frames.values()
    assert len(frame.data_ids) == 6
    for face in FACES:
        with Image.open(folder / "images" / face / "pano_jpg.jpg") as picture:
            assert picture.size == (size, size)


def test_what_a_face_shows_is_what_the_panorama_shows_in_its_direction() -> None:
    """A panorama whose colours are its directions: every face then shows the directions of a pinhole."""
    row, column = np.mgrid[0:512, 0:1024] + 0.5
    azimuth, elevation = np.pi - 2 * np.pi * column / 1024, np.pi / 2 - np.pi * row / 512
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    )
    panorama = np.rint(127.5 + 127.5 * directions).astype(np.uint8)
    for face in FACES:
        shown = cut_face(panorama, 64, face)[16:48:8, 16:48:8] / 127.5 - 1
        for r, c in np.ndindex(4, 4):
            left, up = 1 - (16 + 8 * c + 0.5) / 32, 1 - (16 + 8 * r + 0.5) / 32
            ray = turned(face) @ [1, left, up]
            np.testing.assert_allclose(shown[r, c], ray / np.linalg.norm(ray), atol=0.012, err_msg=face)


def test_three_js_draws_a_point_in_the_middle_of_a_gltf_camera_that_looks_at_it(tmp_path: Path) -> None:
    """A photo turned so that its centre shows the point: the camera of its node looks along −z, with y up."""
    forward = (POINT - GOLDEN.position) / np.linalg.norm(POINT - GOLDEN.position)
    left = np.cross([0, 0, 1], forward) / np.linalg.norm(np.cross([0, 0, 1], forward))
    pose = Pose(np.stack([forward, left, np.cross(forward, left)], axis=1), GOLDEN.position)
    tour = Tour("map_1", (PlacedPhoto("pano.jpg", pose, WIDTH, HEIGHT),))
    (node,) = document_of("gltf", tour, tmp_path, "tour.gltf")["nodes"]
    x, y, z, w = node["rotation"]
    world = np.array([POINT[0], POINT[2], -POINT[1]]) - node["translation"]
    vector = -np.array([x, y, z])
    seen = world + 2 * np.cross(vector, np.cross(vector, world) + w * world)
    np.testing.assert_allclose(seen / np.linalg.norm(seen), [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(GL @ [1, 0, 0], [0, 0, -1])


@pytest.mark.slow
def test_the_faces_of_a_photo_that_exif_turns_are_those_of_the_turned_photo(tmp_path: Path) -> None:
    golden = golden_tour(tmp_path)
    upright = Image.open(tmp_path / "pano.jpg").convert("RGB")
    shown = {}
    for name, picture, orientation in (("upright", upright, 1), ("turned", upright.rotate(180), 3)):
        exif = Image.Exif()
        exif[0x0112] = orientation
        picture.save(tmp_path / f"{name}.png", exif=exif)
        tour = replace(golden, photos=(replace(golden.photos[0], image=tmp_path / f"{name}.png"),))
        folder = written("colmap-rig", tour, tmp_path / name)
        shown[name] = (folder / "images" / "front" / "pano_jpg.jpg").read_bytes()
    assert shown["turned"] == shown["upright"]
