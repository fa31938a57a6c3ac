"""One level of the panorama's pyramid, prepared to be sampled together with its derivatives."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.geometry.projection import fill_border


@dataclass(frozen=True)
class ImageLevel:
    """An image of H x W pixels, ready for `sample`.

    planes: (10, H + 2, W + 2) float32: colour (3), its derivatives by azimuth (3) and by elevation (3) per radian, validity (1);
    with the border of `wrap_border`.
    """

    planes: Tensor
    height: int
    width: int

    def sample(self, azimuth: Tensor, elevation: Tensor) -> Tensor:
        """Return the planes (K, 10, N) at directions (K, N) in radians, bilinearly."""
        # The middle of the image, straight ahead, is the middle of the bordered one, whose outermost centres are at -1 and 1.
        grid = torch.empty((*azimuth.shape, 2), dtype=azimuth.dtype, device=azimuth.device)
        across, down = 2 / (self.width + 1), 2 / (self.height + 1)
        torch.mul(azimuth, -across * self.width / (2 * math.pi), out=grid[..., 0])
        torch.mul(elevation, -down * self.height / math.pi, out=grid[..., 1])
        images = self.planes.expand(len(azimuth), -1, -1, -1)
        sampled = torch.nn.functional.grid_sample(images, grid[:, None], align_corners=True, padding_mode="border")
        return sampled[:, :, 0]


def prepare_level(color: Tensor, valid: Tensor) -> ImageLevel:
    """Prepare an image (3, H, W) float32 with validity (H, W) float32 in 0..1 for sampling."""
    _, height, width = color.shape
    planes = color.new_empty((10, height + 2, width + 2))
    padded, seen = planes[:3], planes[9]
    inside = planes[:, 1:-1, 1:-1]
    inside[:3], inside[9] = color, valid
    fill_border(planes[:3])
    fill_border(planes[9:])
    # Columns run against the azimuth, rows against the elevation. The gradient at the edge of a mask is unknown, not that towards a
    # black pixel.
    across = seen[1:-1, 2:] * seen[1:-1, :-2] * (width / (4 * math.pi))
    down = seen[2:, 1:-1] * seen[:-2, 1:-1] * (height / (2 * math.pi))
    torch.sub(padded[:, 1:-1, :-2], padded[:, 1:-1, 2:], out=inside[3:6]).mul_(across)
    torch.sub(padded[:, :-2, 1:-1], padded[:, 2:, 1:-1], out=inside[6:9]).mul_(down)
    fill_border(planes[3:9])
    return ImageLevel(planes, height, width)
