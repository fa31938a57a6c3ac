"""Local contrast: what lamps do to an image, and what they do not do to its contrast."""

import math

import torch

from panoloc.core.geometry.projection import pixel_directions, project, sample_bilinear
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.light.local_contrast import local_contrast, mixed_with_contrast

HEIGHT, WIDTH = 64, 128


def textured(seed: int = 0) -> torch.Tensor:
    """Return an image (1, H, W, 3) with detail at the size of a few pixels."""
    return 0.3 + 0.6 * torch.rand((1, HEIGHT, WIDTH, 3), generator=torch.Generator().manual_seed(seed))


def lamp() -> torch.Tensor:
    """Return the light (1, H, W, 1) of one lamp: bright on one side, dark on the other, the same across the seam."""
    azimuth = torch.arange(WIDTH) * (2 * math.pi / WIDTH)
    return (0.6 + 0.35 * azimuth.cos()).expand(HEIGHT, -1)[None, ..., None]


def correlation(first: torch.Tensor, second: torch.Tensor) -> float:
    return float(torch.corrcoef(torch.stack((first.flatten(), second.flatten())))[0, 1])


def test_a_lamp_changes_the_image_and_not_its_contrast() -> None:
    image, valid = textured(), torch.ones((1, HEIGHT, WIDTH))
    lit = image * lamp()
    assert correlation(image, lit) < 0.7
    assert correlation(local_contrast(image, valid), local_contrast(lit, valid)) > 0.94


def test_what_is_missing_has_no_part_in_its_surroundings() -> None:
    image, valid = textured(), torch.ones((1, HEIGHT, WIDTH))
    valid[:, 20:40, 30:60] = 0
    repainted = torch.where(valid[..., None] > 0, image, torch.ones(()))
    torch.testing.assert_close(local_contrast(image, valid), local_contrast(repainted, valid))


def test_a_tilted_camera_sees_the_same_contrast() -> None:
    valid = torch.ones((1, HEIGHT, WIDTH))
    directions = pixel_directions(HEIGHT, WIDTH)
    turn = rotation_from_vector(torch.tensor([0.9, -0.6, 0.4]))

    def painted(seen: torch.Tensor) -> torch.Tensor:
        x, y, z = seen.unbind(-1)
        return torch.stack((1.2 + (5 * x + 3 * z).sin(), 1.2 + (7 * y).sin(), 1.2 + (4 * z - 5 * x).cos()), -1) / 2.4

    level = local_contrast(painted(directions)[None], valid)[0]
    tilted = local_contrast(painted(directions @ turn.T)[None], valid)[0]
    u, v = project(directions @ turn.T, HEIGHT, WIDTH)
    expected = sample_bilinear(level.permute(2, 0, 1), u, v)
    assert float((tilted - expected).abs().mean()) < 0.1 * float(expected.std())


def test_a_mixture_goes_from_equalized_colours_to_contrast() -> None:
    image, valid = textured(), torch.ones((1, HEIGHT, WIDTH))
    equalized = torch.rand((1, HEIGHT, WIDTH, 3), generator=torch.Generator().manual_seed(7))
    torch.testing.assert_close(mixed_with_contrast(equalized, image, valid, 0.0), equalized)
    torch.testing.assert_close(mixed_with_contrast(equalized, image, valid, 1.0), local_contrast(image, valid))


def test_the_contrast_of_a_part_is_that_of_a_sphere_that_shows_nothing_else() -> None:
    window = SphereWindow(64, 8, 40, 40, 48)
    made = torch.Generator().manual_seed(4)
    part = torch.rand((1, 40, 48, 3), generator=made)
    color = window.on_sphere(part.flatten(1, 2)).view(1, 64, 128, 3)
    valid = window.on_sphere(torch.ones((1, 40 * 48))).view(1, 64, 128)
    whole = local_contrast(color, valid)[:, 8:48, 40:88]
    found = local_contrast(part, torch.ones((1, 40, 48)), window)
    # At its border the sphere's surroundings are interpolated towards where nothing is known.
    inner = slice(4, -4)
    torch.testing.assert_close(found[:, inner, inner], whole[:, inner, inner], atol=1e-4, rtol=0)
