"""The images of a rig as windows of spheres, at several resolutions.

An image is kept as the window that it fills of an equirectangular sphere around its own camera. A photo of 69 degrees fills a fourteenth of
its sphere, and so can be kept at its own resolution; a panorama fills all of it, around the seam and over the poles.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import torch
from torch import Tensor

from panoloc.core.camera.rig import Rig
from panoloc.core.config import CONTRAST
from panoloc.core.errors import PanoramaUnusableError
from panoloc.core.geometry.projection import (
    pixel_directions,
    pixel_solid_angles,
    pixels_towards,
    unproject,
    wrap_border,
)
from panoloc.core.geometry.sphere_window import SphereWindow, solid_angles_of
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.image.level import BORDER, Level
from panoloc.core.image.photo_window import EXTENT_ROWS, PhotoOnWindow, photo_on_window
from panoloc.core.kernels.library import num_threads


@dataclass(frozen=True)
class Window:
    """An image at one resolution: color (3, h, w) in 0..1, valid (h, w) 0 or 1, at a place on the sphere."""

    color: Tensor
    valid: Tensor
    place: SphereWindow

    def halved(self) -> "Window":
        """Return the window at half the rows; a pixel is valid when at least half of it is."""
        place = self.place.at(self.place.rows // 2)
        if bool(self.valid.all()):
            return Window(_halved(self.color), _halved(self.valid[None])[0], place)
        total, share = _halved(self.color * self.valid), _halved(self.valid[None])[0]
        return Window(total / share.clamp_min(1e-6), (share >= 0.5).float(), place)

    def doubled(self) -> "Window":
        """Return the window at twice the rows, its pixels enlarged."""
        color, valid = (x.repeat_interleave(2, -1).repeat_interleave(2, -2) for x in (self.color, self.valid))
        return Window(color, valid, self.place.at(2 * self.place.rows))


class Windows:
    """All images of a rig at `rows` to a sphere, packed below each other with a border of `BORDER` pixels around each.

    Packed planes are (..., H, W). color: (3, H, W), valid: (H, W). places: of the windows on the sphere. tops: the first row of each
    window, border included, and that after the last.
    """

    def __init__(self, windows: list[Window], rotations: Tensor, centers: Tensor) -> None:
        self.each, self.rows, self._rotations, self._centers = windows, windows[0].place.rows, rotations, centers
        self.places = [window.place for window in windows]
        self.tops = np.cumsum([0, *(len(w.valid) + 2 * BORDER for w in windows)]).tolist()
        self.shape = self.tops[-1], max(w.valid.shape[1] for w in windows) + 2 * BORDER
        self.color = self.packed([w.color * w.valid for w in windows])
        self.valid = self.packed([w.valid for w in windows])

    def packed(self, planes: list[Tensor]) -> Tensor:
        """Return planes (..., h, w) of every window packed; what lies between windows is zero."""
        whole = planes[0].new_zeros((*planes[0].shape[:-2], *self.shape))
        for plane, inside in zip(planes, self.inside(whole), strict=True):
            inside[:] = plane
        return whole

    def inside(self, packed: Tensor) -> list[Tensor]:
        """Return the planes (..., h, w) of every window of packed ones."""
        sizes = (w.valid.shape for w in self.each)
        firsts = (top + BORDER for top in self.tops)
        return [packed[..., y : y + h, BORDER : BORDER + w] for (h, w), y in zip(sizes, firsts, strict=False)]

    @cached_property
    def solid_angles(self) -> Tensor:
        """Return the solid angle (H, W) of each pixel, valid or not."""
        device = self.valid.device
        return self.packed([solid_angles_of(w.place, device).view(w.valid.shape) for w in self.each])

    @cached_property
    def weights(self) -> Tensor:
        """Return the solid angle (H, W) of each pixel, zero where it is not valid."""
        return self.solid_angles * self.valid

    @cached_property
    def image(self) -> Tensor:
        """Return the number (H, W) int64 of the image that each pixel is of."""
        heights = torch.tensor([len(w.valid) + 2 * BORDER for w in self.each], device=self.valid.device)
        rows = torch.arange(len(self.each), device=self.valid.device).repeat_interleave(heights)
        return rows[:, None].expand(self.shape)

    @cached_property
    def directions(self) -> Tensor:
        """Return the direction (H, W, 3) of each pixel in its camera's axes."""
        found = self.valid.new_zeros((*self.shape, 3))
        for at, inside in zip(self.places, self.inside(found.movedim(-1, 0)), strict=True):
            u = at.first_column + torch.arange(at.width, device=found.device) + 0.5
            v = at.first_row + torch.arange(at.height, device=found.device) + 0.5
            inside[:] = unproject(u, v[:, None], self.rows, 2 * self.rows).movedim(-1, 0)
        return found

    @cached_property
    def rig_directions(self) -> Tensor:
        """Return the direction (H, W, 3) of each pixel in the axes of the rig."""
        if len(self.each) == 1:
            return self.directions @ self._rotations[0].T
        return torch.einsum("hwab,hwb->hwa", self._rotations[self.image], self.directions)

    @cached_property
    def as_seen(self) -> Level:
        """Return the level of the windows' own colours."""
        return self.level(self.color)

    def level(self, color: Tensor) -> Level:
        """Return the level of other packed colours (3, H, W) of the same windows.

        A window of a full turn goes on around its seam, and over the poles that it has.
        """
        return self.level_of(torch.cat((color, self.valid[None])))

    def level_of(self, colors: Tensor) -> Level:
        """Return the level of packed colours and validity (4, H, W), whose borders are written."""
        self.continue_around(colors)
        return Level(colors, self.rows, self._places, self._rotations, self._centers)

    @cached_property
    def _places(self) -> Tensor:
        places = [
            (at.first_column - 0.5, at.first_row - 0.5, at.width + 1, at.height + 1, top)
            for at, top in zip(self.places, self.tops, strict=False)
        ]
        return torch.tensor(places, dtype=torch.float32, device=self.valid.device).T.contiguous()

    def continue_around(self, planes: Tensor) -> None:
        """Let the borders of full turns in packed planes (C, H, W) continue them, in place."""
        for at, top in zip(self.places, self.tops, strict=False):
            if not at.is_round:
                continue
            bordered = planes[:, top : top + at.height + 2 * BORDER, : at.width + 2 * BORDER]
            inside = bordered[:, BORDER:-BORDER, BORDER:-BORDER]
            if at.first_row == 0:
                bordered[:, :BORDER, BORDER:-BORDER] = inside[:, :BORDER].flip(1).roll(self.rows, -1)
            if at.first_row + at.height == at.rows:
                bordered[:, -BORDER:, BORDER:-BORDER] = inside[:, -BORDER:].flip(1).roll(self.rows, -1)
            bordered[..., :BORDER] = bordered[..., -2 * BORDER : -BORDER]
            bordered[..., -BORDER:] = bordered[..., BORDER : 2 * BORDER]


class RigPyramid:
    """The images of a rig in its axes: those of the session, from the middle of the cameras.

    rotations: (M, 3, 3) rig_from_camera. centers: (M, 3), metres. cones: (M,) half the opening angle around each optical axis that
    holds all of the image, radians. Raises PanoramaUnusableError where nothing of any image is left once it is made small.
    """

    def __init__(self, rig: Rig, max_rows: int, labels: LabelCodes | None, device: torch.device | str) -> None:
        poses = [image.session_from_camera for image in rig.images]
        middle = rig.session_from_rig.position
        self.labels = labels
        self.rotations = torch.tensor(np.stack([pose.rotation for pose in poses]), dtype=torch.float32, device=device)
        self.centers = torch.tensor(
            np.stack([pose.position - middle for pose in poses]), dtype=torch.float32, device=device
        )
        # Sampled with numpy alone: threads that compute with torch get teams of threads of their own.
        sample = partial(photo_on_window, max_rows=max_rows, is_labels=labels is not None)
        with ThreadPoolExecutor(min(len(rig.photos), num_threads())) as threads:
            each_of = threads.map if len(rig.photos) > 1 else map  # memory of other threads comes slower
            sampled = list(each_of(sample, rig.photos))
        self._levels = [{each.window.rows: _window(each, labels, device)} for each in sampled]
        self.cones = torch.tensor([each.cone for each in sampled], device=device)
        self.finest_rows = max(each.window.rows for each in sampled)
        self._windows: dict[int, Windows] = {}
        if not bool((self.windows(CONTRAST.extent_rows).valid > 0).any()):
            raise PanoramaUnusableError(
                "image: expected contiguous visible pixels, got a mask or transparency that leaves less than half of "
                "the pixels everywhere; mask whole regions, not single pixels"
            )

    def __len__(self) -> int:
        return len(self._levels)

    @cached_property
    def share(self) -> float:
        """Return the share of the sphere, 0..1, that all images together show, overlaps counted once."""
        if self._shows_all:
            return 1.0
        height, width = self._nearness.shape
        weights = pixel_solid_angles(height, width, self.rotations.device) / (4 * math.pi)
        return float(((self._nearness >= 1) * weights).sum())

    @cached_property
    def reach(self) -> float:
        """Return the angle around the optical axis of the first camera, radians, that holds all that the images show, parallax aside."""
        axes = self.rotations[:, :, 0]
        return float(((axes @ axes[0]).clamp(-1, 1).acos() + self.cones).max())

    @cached_property
    def _shows_all(self) -> bool:
        """Return whether some image shows all of the sphere."""
        return any(window.place.is_whole and bool(window.valid.all()) for window in self.windows(EXTENT_ROWS).each)

    @cached_property
    def _nearness(self) -> Tensor:
        """Return the cosine (H, W) of the angle from each pixel of a sphere in the axes of the rig to the nearest that some image shows,
        parallax aside: 1 where one does."""
        windows, rows = self.windows(EXTENT_ROWS), EXTENT_ROWS // 2
        directions = pixel_directions(rows, 2 * rows, self.rotations.device).flatten(0, 1)
        shown = torch.zeros(len(directions), dtype=torch.bool, device=directions.device)
        for number, least in enumerate(self.cones.clamp(max=math.pi).cos() - 1e-6):
            near = (directions @ self.rotations[number, :, 0] >= least).nonzero()[:, 0]
            x, y, z = (directions[near] @ self.rotations[number]).T
            sampled = windows.as_seen.sample(torch.atan2(y, x)[None], torch.asin(z.clamp(-1, 1))[None], number)
            shown[near] |= sampled[0, 3] > 0.5
        around = wrap_border(shown.view(1, rows, -1).float())[0] > 0
        inside = around[:-2, 1:-1] & around[2:, 1:-1] & around[1:-1, :-2] & around[1:-1, 2:]
        border = directions[shown & ~inside.flatten()]
        if not len(border):  # nothing or all of it
            return shown.float().view(rows, -1)
        return torch.where(shown, 1.0, (directions @ border.T).amax(1)).view(rows, -1)

    def shows(self, directions: Tensor, margin: float = 0.0) -> Tensor:
        """Tell which directions (N, 3) in the axes of the rig some image shows, parallax aside, or almost: within `margin`, radians. To a
        pixel of three degrees."""
        if self._shows_all:
            return torch.ones(len(directions), dtype=torch.bool, device=directions.device)
        nearness = self._nearness
        return nearness.flatten()[pixels_towards(directions, len(nearness))] >= math.cos(margin)

    def windows(self, rows: int) -> Windows:
        """Return all windows at `rows` to a sphere, a power of two; of an image that is coarser, its pixels enlarged."""
        if rows not in self._windows:
            each = [_at_rows(levels, rows) for levels in self._levels]
            self._windows[rows] = Windows(each, self.rotations, self.centers)
        return self._windows[rows]


def _window(sampled: PhotoOnWindow, labels: LabelCodes | None, device: torch.device | str) -> Window:
    """Return the window of an image with canonical colours: as they are, or the codes of labels."""
    pixels = torch.from_numpy(np.require(sampled.color, requirements=["C", "W"])).to(device)
    inside = torch.from_numpy(np.require(sampled.seen, requirements=["C", "W"])).to(device)
    if labels is None:
        planes = pixels.permute(2, 0, 1).contiguous().float().div_(255)
    else:
        codes, known = labels.recode(pixels)
        planes, inside = codes.permute(2, 0, 1).contiguous(), inside & known
    return Window(planes, inside.float(), sampled.window)


def _at_rows(levels: dict[int, Window], rows: int) -> Window:
    """Return an image at a resolution, made from the nearest of those known that is finer; those on the way are kept."""
    if rows not in levels:
        finer = min((known for known in levels if known > rows), default=None)
        levels[rows] = _at_rows(levels, rows // 2).doubled() if finer is None else _at_rows(levels, 2 * rows).halved()
    return levels[rows]


def _halved(planes: Tensor) -> Tensor:
    """Average planes (C, H, W) over squares of two pixels a side."""
    rows = planes[:, ::2] + planes[:, 1::2]
    return (rows[..., ::2] + rows[..., 1::2]).mul_(0.25)
