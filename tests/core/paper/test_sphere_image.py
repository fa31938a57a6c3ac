"""The panorama that the paper's method samples: averaged over what is valid, black walls included."""

import numpy as np
import pytest
import torch

from panoloc.core.camera.rig import Panorama
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.paper.sphere_image import SphereImage

CPU = torch.device("cpu")


def test_a_pixel_is_the_mean_of_what_is_valid_where_half_of_it_is() -> None:
    rng = np.random.default_rng(0)
    color, valid = rng.integers(0, 256, (32, 64, 3)).astype(np.uint8), rng.uniform(size=(32, 64)) < 0.6
    found = SphereImage.of_panorama(Panorama(color, valid), 16, None, CPU)
    assert found.height == 16
    for row, column in np.ndindex(16, 32):
        square = slice(2 * row, 2 * row + 2), slice(2 * column, 2 * column + 2)
        assert bool(found.valid[row, column]) == (valid[square].sum() >= 2)
        if valid[square].any():
            expected = color[square][valid[square]].mean(0) / 255
            np.testing.assert_allclose(found.color[:, row, column].numpy(), expected, atol=1e-6)


@pytest.mark.parametrize("most_rows", [16, 64])
def test_black_is_a_colour_and_no_image_is_enlarged(most_rows: int) -> None:
    panorama = Panorama(np.zeros((32, 64, 3), np.uint8), np.ones((32, 64), bool))
    found = SphereImage.of_panorama(panorama, most_rows, None, CPU)
    assert found.height == min(most_rows, 32)
    assert bool(found.valid.all())
    assert float(found.weights().sum()) == pytest.approx(4 * np.pi, rel=1e-5)


def test_labels_become_their_codes_and_unknown_ones_are_masked() -> None:
    labels = LabelCodes(torch.tensor([[255, 0, 0]]), torch.tensor([[0.1, 0.2, 0.3]]))
    color = np.full((16, 32, 3), (255, 0, 0), np.uint8)
    color[:, 16:] = (10, 200, 90)
    found = SphereImage.of_panorama(Panorama(color, np.ones((16, 32), bool)), 8, labels, CPU)
    assert found.valid.mean(0).tolist() == [1.0] * 8 + [0.0] * 8
    torch.testing.assert_close(found.color[:, :, :8], torch.tensor([0.1, 0.2, 0.3])[:, None, None].expand(3, 8, 8))
