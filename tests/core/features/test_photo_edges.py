"""Edges of photos: where they are found, and the planes that they lie in."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.config import JudgeConfig, LineConfig
from panoloc.core.features.line_support import Edges, edges_of_photos
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.rig_pyramid import RigPyramid
from tests.core.image.painted_photos import pinhole_rays
from tests.core.painted_box import rotation_of

CAMERA = Camera.from_hfov("pinhole", 480, 360, 69.0)
CONFIG = LineConfig()
NORMAL = np.array([0.2, 0.9, -0.3]) / np.linalg.norm([0.2, 0.9, -0.3])


def photo(color: NDArray[np.float64], valid: NDArray[np.bool_] | None = None) -> Photo:
    """Return a photo whose pixels have the brightness `color` (H, W) in 0..1."""
    pixels = np.repeat((color * 255).astype(np.uint8)[..., None], 3, axis=-1)
    return Photo(pixels, np.ones(color.shape, bool) if valid is None else valid, CAMERA)


def halves() -> NDArray[np.float64]:
    """Return what a camera sees of a straight edge between dark and bright, in the plane of NORMAL."""
    # As a lens draws it, half of a pixel wide.
    return np.asarray(0.55 + 0.25 * np.tanh(pinhole_rays(CAMERA) @ NORMAL * 400))


def edges_of(*photos: Photo, poses: tuple[Pose, ...] = ()) -> Edges:
    here = Pose(np.eye(3), np.zeros(3))
    images = tuple(RigImage(*both) for both in zip(photos, poses or (here,), strict=True))
    return edges_of_photos(RigPyramid(Rig(images), 512, None, "cpu"), 512, replace(CONFIG, edges_in_square=9999))


def angles_deg(normals: Tensor, wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much normals (E, 3) differ from a wanted one (3,), either way round."""
    cosine = np.abs(normals.double().numpy() @ wanted).clip(0, 1)
    return np.asarray(np.degrees(np.arccos(cosine)))


def test_an_edge_is_the_plane_through_the_lens_and_the_edge() -> None:
    edges = edges_of(photo(halves()))
    assert len(edges.normals) > 25
    assert np.percentile(angles_deg(edges.normals, NORMAL), 90) < 2.5
    off = np.degrees(np.arcsin(np.abs(edges.directions.double().numpy() @ NORMAL).clip(0, 1)))
    assert np.percentile(off, 90) < 1.0  # and they lie on it


def test_edges_of_a_panorama_go_all_around_and_are_in_one_plane() -> None:
    rows, normal = 512, np.array([0.7, 0.1, 0.7]) / np.linalg.norm([0.7, 0.1, 0.7])
    azimuth = np.pi - np.pi * (np.arange(2 * rows) + 0.5) / rows
    elevation = (np.pi / 2 - np.pi * (np.arange(rows) + 0.5) / rows)[:, None]
    flat = np.cos(elevation)
    side = normal[0] * flat * np.cos(azimuth) + normal[1] * flat * np.sin(azimuth) + normal[2] * np.sin(elevation)
    color = ((0.55 + 0.25 * np.tanh(side * 300))[..., None] * np.full(3, 255)).astype(np.uint8)
    edges = edges_of(Photo.of_panorama(Panorama(color, np.ones(side.shape, bool))))
    assert np.percentile(angles_deg(edges.normals, normal), 95) < 2.5
    along = np.linalg.svd(normal[None])[2][1:] @ edges.directions.double().numpy().T
    turned = np.degrees(np.arctan2(along[1], along[0]))
    assert np.histogram(turned, 18, (-180, 180))[0].min() > 5


def test_edges_are_in_the_axes_of_the_rig() -> None:
    turn = rotation_of(70.0, 10.0, 25.0)
    poses = Pose(turn, np.zeros(3)), Pose(rotation_of(-80.0), np.zeros(3))
    edges = edges_of(photo(halves()), photo(np.full((360, 480), 0.5)), poses=poses)
    assert np.percentile(angles_deg(edges.normals, turn @ NORMAL), 90) < 2.5


def test_the_border_of_what_is_valid_is_no_edge() -> None:
    color, valid = halves(), np.ones((360, 480), bool)
    valid[:, :200] = False
    edges = edges_of(photo(color * valid, valid))
    assert len(edges.normals) > 25
    assert np.percentile(angles_deg(edges.normals, NORMAL), 95) < 3.0


@pytest.mark.parametrize("brightness", [0.0, 0.5, 1.0])
def test_a_photo_of_one_color_has_no_edges(brightness: float) -> None:
    assert len(edges_of(photo(np.full((360, 480), brightness))).normals) == 0


def test_edges_are_as_long_as_they_are_in_the_photo() -> None:
    across = edges_of(photo(halves())).length_deg
    assert 50 < across < 90  # from one side of a photo of 69 x 54 degrees to another, askew


def test_a_wall_in_soft_light_has_no_edges_however_grainy() -> None:
    rows, columns = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px]
    grain = np.random.default_rng(0).normal(0, 0.01, rows.shape)
    soft = 0.6 + 0.15 * rows / CAMERA.height_px - 0.1 * columns / CAMERA.width_px
    for wall in (soft, soft + grain):
        assert edges_of(photo(wall.clip(0, 1))).length_deg < JudgeConfig().least_edges_deg / 2


def test_edges_are_taken_from_everywhere() -> None:
    # A striped rug has the strongest edges by far, more than are taken.
    image = halves()
    rows, columns = image.shape
    image[: rows // 2, : columns // 2] = np.where(np.arange(columns // 2) % 24 < 12, 0.05, 0.95)
    here = Pose(np.eye(3), np.zeros(3))
    found = edges_of_photos(RigPyramid(Rig((RigImage(photo(image), here),)), 512, None, "cpu"), 512, CONFIG)
    step = angles_deg(found.normals, NORMAL) < 3
    assert int(step.sum()) > len(found.normals) / 20
