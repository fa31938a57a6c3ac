"""Colours that are equalized, fitted in gain and offset, taken for labels, or held against their surroundings."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from panoloc.core.decide.change_maps import fit_gain_offset
from panoloc.core.features.local_contrast import local_contrast
from panoloc.core.geometry.projection import pixel_directions, project, sample_bilinear
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.geometry.sphere_window import SphereWindow
from panoloc.core.image.label_codes import label_codes


def test_rare_colours_are_noise_not_labels() -> None:
    colors = torch.zeros((50_000, 3), dtype=torch.uint8)
    colors[25_000:] = 255
    colors[7] = torch.tensor([9, 99, 199], dtype=torch.uint8)
    assert len(label_codes(colors).labels) == 2


@settings(deadline=None)
@given(hnp.arrays(np.uint8, st.tuples(st.integers(1, 30), st.just(3))), st.integers(-10, 10))
def test_label_colours_survive_the_noise_of_compression(labels: np.ndarray, noise: int) -> None:
    separated = (labels // 64 * 64 + 20).astype(np.uint8)
    codes = label_codes(torch.from_numpy(separated))
    exact, known = codes.recode(torch.from_numpy(separated))
    noisy, noisy_known = codes.recode(torch.from_numpy((separated.astype(int) + noise).astype(np.uint8)))
    assert bool(known.all())
    assert bool(noisy_known.all())
    assert torch.equal(exact, noisy)
    num_labels, num_codes = len(np.unique(separated, axis=0)), len(torch.unique(codes.codes, dim=0))
    assert num_labels == num_codes


def test_gain_and_offset_are_those_of_a_weighted_line_fit() -> None:
    rng = np.random.default_rng(0)
    source = rng.uniform(size=(200, 3))
    target = source * [0.8, 1.5, 0.6] + [0.1, -0.2, 0.05] + rng.normal(0, 0.01, (200, 3))
    weights = rng.uniform(size=200)
    given = [torch.from_numpy(each)[None] for each in (source, target, weights)]
    gain, offset = fit_gain_offset(given[0], given[1], given[2], 3.0)
    lines = [np.polyfit(source[:, channel], target[:, channel], 1, w=np.sqrt(weights)) for channel in range(3)]
    np.testing.assert_allclose(np.stack((gain[0], offset[0]), axis=1), lines, atol=0.02)


@pytest.mark.parametrize(("slope", "expected"), [(10.0, 3.0), (2.9, 2.9), (0.4, 0.4), (0.1, 1 / 3), (-1.0, 1 / 3)])
def test_gains_stay_within_what_cameras_do_and_the_offset_still_meets_the_mean(slope: float, expected: float) -> None:
    source = torch.linspace(0, 1, 200).expand(3, -1).T[None]
    gain, offset = fit_gain_offset(source, slope * source + 0.2, torch.ones((1, 200)), 3.0)
    assert gain[0].tolist() == pytest.approx([expected] * 3, abs=0.03)
    assert (gain * 0.5 + offset)[0].tolist() == pytest.approx([slope * 0.5 + 0.2] * 3, abs=1e-5)


def test_where_there_is_no_contrast_the_gain_is_one() -> None:
    source = torch.full((1, 50, 3), 0.4)
    gain, offset = fit_gain_offset(source, source + 0.1, torch.ones((1, 50)), 3.0)
    assert gain[0].tolist() == pytest.approx([1.0] * 3, abs=1e-4)
    assert offset[0].tolist() == pytest.approx([0.1] * 3, abs=1e-4)


# Local contrast: what lamps do to an image, and what they do not do to its contrast.

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
