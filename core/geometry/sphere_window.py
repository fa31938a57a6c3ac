"""A part of an equirectangular image: what is drawn and compared where no more of the sphere is wanted.

A photo of 69 degrees shows a fourteenth of the sphere; an image of all of it costs as much as fourteen of the photo.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.geometry.projection import pixel_solid_angles, project

_ROUNDING = 1e-6  # of a cell
_SECTORS = 720  # of the horizon, to which its used part is rounded up

CELLS = 8  # rows of squares that windows are made of, twice as many columns: coarse images and patches keep their pixels whole


@dataclass(frozen=True)
class SphereWindow:
    """Pixels of the image of a sphere of `rows` rows and twice as many columns: `height` x `width` of them, from a first row and column."""

    rows: int
    first_row: int
    first_column: int
    height: int
    width: int

    @staticmethod
    def of_sphere(rows: int) -> "SphereWindow":
        """Return the window that is all of the sphere."""
        return SphereWindow(rows, 0, 0, rows, 2 * rows)

    @property
    def is_whole(self) -> bool:
        """Return whether it is all of the sphere."""
        return self.height == self.rows and self.is_round

    @property
    def is_round(self) -> bool:
        """Return whether its last column is followed by its first."""
        return self.width == 2 * self.rows

    def at(self, rows: int) -> "SphereWindow":
        """Return the same part of an image of `rows` rows; both numbers of rows are multiples of `CELLS`, or it is whole."""
        if self.is_whole:
            return SphereWindow.of_sphere(rows)
        scaled = (value * rows // self.rows for value in (self.first_row, self.first_column, self.height, self.width))
        return SphereWindow(rows, *scaled)

    def grid(self) -> NDArray[np.float64]:
        """Return the unit viewing direction (h, w, 3) of every pixel's centre."""
        row, column = self.first_row + np.arange(self.height) + 0.5, self.first_column + np.arange(self.width) + 0.5
        elevation, azimuth = np.pi / 2 - np.pi * row / self.rows, np.pi - np.pi * column / self.rows
        flat, rise = np.cos(elevation)[:, None], np.sin(elevation)[:, None]
        return np.stack(
            (flat * np.cos(azimuth), flat * np.sin(azimuth), np.broadcast_to(rise, (self.height, self.width))), -1
        )

    def pixels_towards(self, directions: Tensor) -> tuple[Tensor, Tensor]:
        """Return the number (...) of the pixel that shows each direction (..., 3), 0 outside, and which of them are inside."""
        pixel, inside = self.pixels_at(*project(directions, self.rows, 2 * self.rows))
        return torch.where(inside, pixel, 0), inside

    def pixels_at(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """Return the number (...) of the pixel at coordinates (...) of the sphere, which means nothing outside, and which are inside."""
        row = v.long().clamp_(0, self.rows - 1) - self.first_row
        column = u.long().clamp_(0, 2 * self.rows - 1) - self.first_column
        inside = (row >= 0) & (row < self.height) & (column >= 0) & (column < self.width)
        return row * self.width + column, inside

    def on_sphere(self, image: Tensor, missing: float = 0.0) -> Tensor:
        """Return an image (K, S, ...) of the window as one of the whole sphere, `missing` elsewhere."""
        if self.is_whole:
            return image
        whole = image.new_full((len(image), self.rows, 2 * self.rows, *image.shape[2:]), missing)
        rows = slice(self.first_row, self.first_row + self.height)
        columns = slice(self.first_column, self.first_column + self.width)
        whole[:, rows, columns] = image.reshape(len(image), self.height, self.width, *image.shape[2:])
        return whole.flatten(1, 2)


def window_around(azimuths: Tensor, elevations: Tensor, margin: float) -> tuple[float, SphereWindow]:
    """Return by which azimuth to turn a sphere, and the least window of cells of it that then holds directions with a margin around.

    azimuths, elevations: (N,) of directions, radians; margin: radians. The window's middle lies where the turned azimuth is zero.
    """
    low, high = float(elevations.min()) - margin, float(elevations.max()) + margin
    cell = math.pi / CELLS
    first_row = max(0, math.floor((math.pi / 2 - high) / cell + _ROUNDING))
    last_row = min(CELLS, math.ceil((math.pi / 2 - low) / cell - _ROUNDING))
    middle, reach = _arc(azimuths, elevations, margin)
    columns = min(CELLS, math.ceil(reach / cell - _ROUNDING))
    return middle, SphereWindow(CELLS, first_row, CELLS - columns, last_row - first_row, 2 * columns)


def _arc(azimuths: Tensor, elevations: Tensor, margin: float) -> tuple[float, float]:
    """Return the middle of the least arc of azimuths that holds all directions with the margin around, and half its length."""
    if bool((elevations.abs() + margin >= math.pi / 2).any()):
        return 0.0, math.pi
    # On the sphere a margin spans the more of the azimuth the nearer it is to a pole.
    wide = torch.asin((math.sin(margin) / elevations.cos()).clamp(max=1.0))
    sector = 2 * math.pi / _SECTORS
    first, end = ((azimuths - wide) / sector).floor().long(), ((azimuths + wide) / sector).ceil().long()
    begun = first.remainder(_SECTORS)
    steps = torch.zeros(2 * _SECTORS + 1, dtype=torch.int64, device=azimuths.device)
    steps.index_add_(0, begun, torch.ones_like(begun)).index_add_(0, begun + end - first, -torch.ones_like(begun))
    twice = steps[:-1].cumsum(0) > 0
    used = (twice[:_SECTORS] | twice[_SECTORS:]).nonzero()[:, 0]
    following = torch.cat((used[1:], used[:1] + _SECTORS))
    free = following - used - 1
    longest = int(free.argmax())
    length = _SECTORS - int(free[longest])
    middle = (int(following[longest]) + length / 2) * sector
    return math.remainder(middle, 2 * math.pi), length / 2 * sector


@lru_cache(maxsize=8)
@torch.inference_mode(False)  # it outlives the query that asked for it first
def directions_of(window: SphereWindow, device: torch.device) -> Tensor:
    """Return the unit viewing direction (S, 3) of every pixel's centre, row by row. Not to be changed: many share it."""
    return torch.from_numpy(window.grid()).float().to(device).view(-1, 3)


@lru_cache(maxsize=8)
@torch.inference_mode(False)
def solid_angles_of(window: SphereWindow, device: torch.device) -> Tensor:
    """Return the solid angle (S,) in steradians of every pixel, row by row. Not to be changed: many share it."""
    solid = pixel_solid_angles(window.rows, 2 * window.rows, device)
    rows = slice(window.first_row, window.first_row + window.height)
    return solid[rows].expand(-1, window.width).flatten()
