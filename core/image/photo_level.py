"""One resolution of all photos of a session, prepared to be sampled together with their derivatives.

Each photo is kept as the window of its own sphere that it fills, all windows below each other in one image, so that points that fall
into different photos are sampled in one go.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class PhotoLevel:
    """Windows of M photos at `rows` to a sphere.

    planes: (10, H, W) float32: colour (3), its derivatives by azimuth (3) and by elevation (3) per radian, validity (1); a border of one
    pixel around each window is not valid. tops: (M,) first row of each window in the planes, border included. first_rows, first_columns:
    (M,) where the windows lie on their spheres. heights, widths: (M,) of the windows, without the border.
    """

    planes: Tensor
    rows: int
    tops: Tensor
    first_rows: Tensor
    first_columns: Tensor
    heights: Tensor
    widths: Tensor

    def sample(self, azimuth: Tensor, elevation: Tensor, photo: Tensor | int) -> Tensor:
        """Return the planes (K, 10, N) at directions (K, N), radians, in the axes of the photos numbered `photo` (K, N), or of one of them.

        Outside of a photo's window validity is zero.
        """
        first_column, first_row, last_column, last_row, top = self._places(photo)
        per_rad = self.rows / math.pi
        # In pixels from the centre of a window's top-left border pixel.
        column = (math.pi - azimuth) * per_rad - first_column
        row = (math.pi / 2 - elevation) * per_rad - first_row
        column = torch.minimum(column.clamp_min(0), last_column)
        row = torch.minimum(row.clamp_min(0), last_row) + top
        height, width = self.planes.shape[1:]
        grid = torch.stack((column * (2 / (width - 1)) - 1, row * (2 / (height - 1)) - 1), dim=-1)
        images = self.planes.expand(len(azimuth), -1, -1, -1)
        sampled = torch.nn.functional.grid_sample(images, grid[:, None], align_corners=True, padding_mode="border")
        return sampled[:, :, 0]

    def _places(self, photo: Tensor | int) -> Tensor:
        """Return of the windows of photos (K, N), or of one of them: first column and row less the border, last ones, and top, (5, ...)."""
        places = torch.stack(
            (self.first_columns - 0.5, self.first_rows - 0.5, self.widths + 1, self.heights + 1, self.tops.float())
        )
        if isinstance(photo, int):
            return places[:, photo]
        return places.index_select(1, photo.flatten()).view(5, *photo.shape)


@dataclass(frozen=True)
class PhotoWindows:
    """Colours of the windows, packed as in `PhotoLevel`: color (3, H, W) in 0..1, valid (H, W) 0 or 1, weights (H, W) solid angles.

    direction: (3, H, W), of each pixel in its photo's axes. photo: (H, W) int64, the photo that a pixel is of. A window of a full turn
    has no border at its sides: its last column is followed by its first.
    """

    color: Tensor
    valid: Tensor
    weights: Tensor
    direction: Tensor
    photo: Tensor
    rows: int
    tops: Tensor
    first_rows: Tensor
    first_columns: Tensor
    heights: Tensor
    widths: Tensor

    def level(self, color: Tensor) -> PhotoLevel:
        """Return the level of other colours (3, H, W) of the same windows."""
        _, height, width = color.shape
        planes = color.new_zeros((10, height, width))
        planes[:3], planes[9] = color, self.valid
        seen = self.valid
        per_rad = self.rows / (2 * math.pi)
        # Columns run against the azimuth, rows against the elevation; at the edge of what is valid the gradient is unknown.
        across = seen[:, 2:] * seen[:, :-2] * per_rad
        down = seen[2:] * seen[:-2] * per_rad
        planes[3:6, :, 1:-1] = (color[:, :, :-2] - color[:, :, 2:]) * across
        planes[6:9, 1:-1] = (color[:, :-2] - color[:, 2:]) * down
        self._continue_around(planes)
        return PhotoLevel(planes, self.rows, self.tops, self.first_rows, self.first_columns, self.heights, self.widths)

    def _continue_around(self, planes: Tensor) -> None:
        """Let the borders of full turns continue them, in place: the colours' derivatives do not end at the seam."""
        places = zip(self.tops.tolist(), self.heights.tolist(), self.widths.tolist(), strict=True)
        for top, height, width in ((int(t), int(h), int(w)) for t, h, w in places if w == 2 * self.rows):
            window = planes[3:9, top : top + height + 2]
            window[..., 0], window[..., width + 1] = window[..., width], window[..., 1]
