"""The photos of a session as windows of spheres, at several resolutions.

A photo of 69 degrees fills a fourteenth of its sphere: as a window it can be kept at its own resolution, which a whole sphere of that
fineness would make too large.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from panoloc.core.camera.lens import project_to_image
from panoloc.core.camera.rig import Photo, Session, session_from_rig
from panoloc.core.errors import PanoramaUnusableError
from panoloc.core.features.equalization import LabelCodes
from panoloc.core.geometry.projection import pixel_solid_angles, unproject
from panoloc.core.geometry.rotations import even_directions
from panoloc.core.image.image_on_sphere import small_sphere_directions
from panoloc.core.image.photo_level import PhotoWindows
from panoloc.core.image.photo_window import PhotoOnWindow, photo_on_window

_LEAST_ROWS = 256
_EXTENT_LEVEL = 32  # rows of the windows that tell what photos show
_SHARE_DIRECTIONS = 8192
_SHOWN_ROWS = 128  # of the windows whose pixels stand for what photos show


@dataclass(frozen=True)
class _Window:
    """A window: color (3, h, w), valid (h, w), share of valid pixels at coarser levels; where it lies on a sphere of `rows` rows."""

    color: Tensor
    valid: Tensor
    rows: int
    first_row: int
    first_column: int


class PhotoAtlas:
    """Photos of a session in the axes of the rig: those of the session, from the middle of the cameras.

    rotations: (M, 3, 3) rig_from_camera. centers: (M, 3), metres. cones: (M,) half the opening angle around each optical axis that
    holds all of the photo, radians. Raises PanoramaUnusableError where nothing of any photo is left once it is made small.
    """

    def __init__(self, session: Session, max_rows: int, labels: LabelCodes | None, device: torch.device | str) -> None:
        poses = [image.session_from_camera for image in session.images]
        middle = session_from_rig(session).position
        self.labels = labels
        self.rotations = torch.tensor(np.stack([pose.rotation for pose in poses]), dtype=torch.float32, device=device)
        self.centers = torch.tensor(
            np.stack([pose.position - middle for pose in poses]), dtype=torch.float32, device=device
        )
        sampled = _each_sampled([image.photo for image in session.images], max_rows, labels is not None)
        self._top = [_window(each, labels, device) for each in sampled]
        self.cones = torch.tensor([each.cone for each in sampled], device=device)
        self._windows: dict[int, PhotoWindows] = {}
        if not bool((self.windows(_EXTENT_LEVEL).valid > 0).any()):
            raise PanoramaUnusableError(
                "image: expected contiguous visible pixels, got a mask or transparency that leaves less than half of "
                "the pixels everywhere; mask whole regions, not single pixels"
            )

    def __len__(self) -> int:
        return len(self._top)

    @property
    def finest_rows(self) -> int:
        """Return the rows of the finest level that some photo has."""
        return max(window.rows for window in self._top)

    def rig_directions(self, windows: PhotoWindows) -> Tensor:
        """Return the directions (H, W, 3) of the pixels of windows in the axes of the rig."""
        directions = windows.direction.permute(1, 2, 0)
        if len(self) == 1:
            return directions @ self.rotations[0].T
        return torch.einsum("hwab,hwb->hwa", self.rotations[windows.photo], directions)

    def share(self) -> float:
        """Return the share of the sphere, 0..1, that all photos together show, overlaps counted once."""
        return float(self.shows(even_directions(_SHARE_DIRECTIONS).to(self.rotations.device)).float().mean())

    def shown_directions(self) -> Tensor:
        """Return directions (N, 3) in the axes of the rig that some photo shows, all that it shows within a degree of one."""
        windows = self.windows(_SHOWN_ROWS)
        return self.rig_directions(windows)[windows.valid > 0]

    def shows(self, directions: Tensor, margin: float = 0.0) -> Tensor:
        """Tell which directions (N, 3) in the axes of the rig some photo shows, or almost: within `margin`, radians."""
        windows = self.windows(_EXTENT_LEVEL)
        pixels, of = self.rig_directions(windows)[windows.valid > 0], windows.photo[windows.valid > 0]
        reach = margin + 0.71 * math.pi / _EXTENT_LEVEL  # half a pixel's diagonal
        # Most directions are nowhere near a photo: the cones around them tell these apart at once.
        near = directions @ self.rotations[:, :, 0].T >= (self.cones + reach).clamp(max=math.pi).cos() - 1e-6
        shown = torch.zeros(len(directions), dtype=torch.bool, device=directions.device)
        for number in range(len(self)):
            some = (near[:, number] & ~shown).nonzero()[:, 0]
            if len(some) and bool((of == number).any()):
                shown[some] = (directions[some] @ pixels[of == number].T).amax(1) >= math.cos(reach)
        return shown

    def windows(self, rows: int) -> PhotoWindows:
        """Return all windows at `rows` to a sphere, a power of two; of a photo that is coarser, its pixels enlarged."""
        if rows not in self._windows:
            self._windows[rows] = _packed([_at_rows(window, rows) for window in self._top], rows)
        return self._windows[rows]


def shown_share(session: Session) -> float:
    """Return about the share of the sphere, 0..1, that the photos of a session show together, overlaps counted once."""
    row, directions = np.arange(_EXTENT_LEVEL) + 0.5, small_sphere_directions(_EXTENT_LEVEL)
    shown = np.zeros(directions.shape[:2], np.bool_)
    for image in session.images:
        shown |= project_to_image(image.photo.camera, directions @ image.session_from_camera.rotation)[2]
    return float((shown * np.sin(np.pi * row / _EXTENT_LEVEL)[:, None]).mean() * np.pi / 2)


def _rows_for(photo: Photo, max_rows: int) -> int:
    wanted = math.pi * min(photo.camera.fx_px, photo.camera.fy_px)
    return int(min(max(2 ** round(math.log2(max(wanted, 1.0))), _LEAST_ROWS), max_rows))


def _each_sampled(photos: list[Photo], max_rows: int, is_labels: bool) -> list[PhotoOnWindow]:
    """Sample photos beside each other; a single one in this thread."""

    def sample(photo: Photo) -> PhotoOnWindow:
        """Sample one photo, with numpy alone: threads that compute with torch get teams of threads of their own."""
        return photo_on_window(photo, _rows_for(photo, max_rows), is_labels)

    if len(photos) == 1:
        return [sample(photos[0])]
    with ThreadPoolExecutor(min(len(photos), torch.get_num_threads())) as threads:
        return list(threads.map(sample, photos))


def _window(sampled: PhotoOnWindow, labels: LabelCodes | None, device: torch.device | str) -> _Window:
    """Return the window of a photo with canonical colours: as they are, or the codes of labels."""
    pixels, inside = torch.from_numpy(sampled.color).to(device), torch.from_numpy(sampled.seen).to(device)
    if labels is None:
        planes = pixels.permute(2, 0, 1).float() / 255
    else:
        codes, known = labels.recode(pixels)
        planes, inside = codes.permute(2, 0, 1).contiguous(), inside & known
    return _Window(planes, inside.float(), sampled.rows, sampled.first_row, sampled.first_column)


def _at_rows(window: _Window, rows: int) -> _Window:
    """Return a window at another resolution; a pixel is valid when at least half of it is."""
    color, valid, at = window.color, window.valid, window.rows
    while at > rows:
        total, share = _halved(color * valid), _halved(valid[None])
        color, valid, at = total / share.clamp_min(1e-6), (share[0] >= 0.5).float(), at // 2
    while at < rows:
        color, valid = (x.repeat_interleave(2, -1).repeat_interleave(2, -2) for x in (color, valid))
        at *= 2
    scale = rows / window.rows
    return _Window(color, valid, rows, round(window.first_row * scale), round(window.first_column * scale))


def _halved(planes: Tensor) -> Tensor:
    """Average planes (C, H, W) over squares of two pixels a side."""
    rows = planes[:, ::2] + planes[:, 1::2]
    return (rows[..., ::2] + rows[..., 1::2]) * 0.25


def _packed(windows: list[_Window], rows: int) -> PhotoWindows:
    """Put windows below each other, with a border of one pixel around each."""
    device = windows[0].color.device
    height = sum(w.valid.shape[0] + 2 for w in windows)
    width = max(w.valid.shape[1] for w in windows) + 2
    color, valid = torch.zeros((3, height, width), device=device), torch.zeros((height, width), device=device)
    weights, direction = torch.zeros_like(valid), torch.zeros_like(color)
    photo = torch.zeros((height, width), dtype=torch.int64, device=device)
    solid, tops, top = pixel_solid_angles(rows, 2 * rows, device), [], 0
    for number, window in enumerate(windows):
        h, w = window.valid.shape
        inside = (slice(top + 1, top + 1 + h), slice(1, w + 1))
        color[:, *inside], valid[inside] = window.color * window.valid, window.valid
        weights[inside] = window.valid * solid[window.first_row : window.first_row + h]
        at_row = torch.arange(window.first_row - 1, window.first_row + h + 1, device=device) + 0.5
        at_column = torch.arange(window.first_column - 1, window.first_column + w + 1, device=device) + 0.5
        v, u = torch.meshgrid(at_row, at_column, indexing="ij")
        direction[:, top : top + h + 2, : w + 2] = unproject(u, v, rows, 2 * rows).permute(2, 0, 1)
        photo[top : top + h + 2] = number
        if w == 2 * rows:  # a full turn goes on around
            for target, source in ((0, w), (w + 1, 1)):
                color[:, top : top + h + 2, target] = color[:, top : top + h + 2, source]
                valid[top : top + h + 2, target] = valid[top : top + h + 2, source]
        tops.append(top)
        top += h + 2

    def numbers(values: list[int]) -> Tensor:
        """Return one number per window."""
        return torch.tensor(values, dtype=torch.float32, device=device)

    return PhotoWindows(
        color,
        valid,
        weights,
        direction,
        photo,
        rows,
        numbers(tops),
        numbers([w.first_row for w in windows]),
        numbers([w.first_column for w in windows]),
        numbers([w.valid.shape[0] for w in windows]),
        numbers([w.valid.shape[1] for w in windows]),
    )
