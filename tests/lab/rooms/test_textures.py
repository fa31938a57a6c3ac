"""Textures are found at the right place, at the right scale."""

import numpy as np

from panoloc.lab.rooms.materials.texture import Texture, TextureAtlas, plain
from panoloc.lab.rooms.objects.solids import box, cylinder, ellipsoid


def quarters() -> Texture:
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:32, :32], pixels[:32, 32:], pixels[32:, :32] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    return Texture(pixels, (2.0, 2.0))


def sample(texture: Texture, u: float, v: float, footprint_m: float = 0.01) -> list[float]:
    atlas = TextureAtlas([plain((0.5, 0.5, 0.5)), texture])
    place = np.array([[u, v]], np.float32)
    color = atlas.sample(np.array([1]), place, np.array([footprint_m], np.float32))
    return [round(float(value), 3) for value in color[0]]


def test_v_runs_upwards_from_the_bottom_row_and_a_texture_repeats() -> None:
    assert sample(quarters(), 0.5, 1.5) == [1, 0, 0]
    assert sample(quarters(), 1.5 - 4.0, 1.5 + 6.0) == [0, 1, 0]
    assert sample(quarters(), 0.5, 0.5) == [0, 0, 1]


def test_a_far_texture_fades_into_its_mean() -> None:
    stripes = np.zeros((64, 64, 3), np.uint8)
    stripes[:, ::2] = 255
    far = sample(Texture(stripes, (1.0, 1.0)), 0.31, 0.62, footprint_m=1.0)
    assert all(abs(value - (128 / 255) ** 2.2) < 0.02 for value in far)


def test_normals_of_solids_point_outwards() -> None:
    paint = plain((1, 1, 1))
    for parts in (
        box((1, 2, 3), paint, (0, 0, -1.5)),
        cylinder(1.0, 2.0, paint, (0, 0, -1.0)),
        ellipsoid((1, 2, 3), paint, (0, 0, 0)),
    ):
        for part in parts:
            a, b, c = (part.vertices[part.triangles[:, k]] for k in range(3))
            normal = np.cross(b - a, c - a)
            real = np.linalg.norm(normal, axis=1) > 1e-9
            assert ((normal * (a + b + c)).sum(1)[real] > 0).all()
