"""Where a photo differs from the scan seen from its pose, in structure and in colour, after photometric normalization.

The light of another day changes colours smoothly over the sphere, a change of the place does not. So gain and offset of each channel are
fitted on wide surroundings in logarithms, robustly; what remains counts, in plain areas as much as at edges.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.camera.rig import Panorama
from panoloc.core.changes.config import CHANGES
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions, pixel_solid_angles, project, sample_bilinear, wrap_border
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import render_views

_POOL = 4  # light is fitted on images so many times smaller


@dataclass(frozen=True)
class PhotoEvidence:
    """A photo against the scan, on a sphere of (H, 2H) pixels in axes parallel to the map's.

    center: (3,) metres in the axes of the cloud. changed: (H, 2H), 0 as scanned to 1 changed; 0 where `known` is not. known: both sides
    show something. color: (H, 2H, 3) of the photo as it would look in the light of the scan, 0..1. depth: (H, 2H) metres of the scan, inf
    for nothing. edges: (2, H, 2H), how much colours vary around a pixel of the scan and of the
    photo, 0..1: a picture that came has edges in the photo alone.
    """

    center: Tensor
    changed: Tensor
    known: Tensor
    color: Tensor
    depth: Tensor
    edges: Tensor


def photo_evidence(cloud: RenderCloud, panorama: Panorama, cloud_from_camera: Pose) -> PhotoEvidence:
    """Compare a photo with a cloud rendered at its pose."""
    rows = CHANGES.rows
    center = torch.from_numpy(cloud_from_camera.position).float()
    views = render_views(cloud, center[None], rows, with_points=False)
    photo, shown = _in_map_axes(panorama, torch.from_numpy(cloud_from_camera.rotation).float(), rows)
    known = views.valid[0] & shown
    scan = (views.color[0].permute(2, 0, 1) + CHANGES.dark).log()
    seen = (photo + CHANGES.dark).log()
    fitted = seen + _light(scan - seen, known)
    apart = torch.minimum(_nearest(fitted, scan), _nearest(scan, fitted)) / CHANGES.half
    changed = apart.square() / (1 + apart.square())
    changed = _around(torch.where(known, changed, 0.0))
    color = (fitted.exp() - CHANGES.dark).clamp(0, 1).permute(1, 2, 0)
    edges = torch.stack((_edges(scan), _edges(fitted))) * known
    return PhotoEvidence(center, changed * known, known, color, _without_gaps(views.depth[0]), edges)


def color_distance(difference: Tensor) -> Tensor:
    """Return how far apart colours are whose logarithms differ by (3, ...): brightness counts once, hue and saturation more."""
    red, green, blue = difference
    bright = difference.mean(0)
    hue = torch.hypot(red - green, (red + green) / 2 - blue)
    return torch.hypot(bright, CHANGES.hue_weight * hue)


def _without_gaps(depth: Tensor) -> Tensor:
    """Return depths (H, 2H) in which gaps of one or two pixels, which rendering filled with colour alone, have the least depth around."""
    for _ in range(2):
        around = -torch.nn.functional.max_pool2d(-wrap_border(depth[None])[None], 3, 1)[0, 0]
        depth = torch.where(depth.isfinite(), depth, around)
    return depth


def _in_map_axes(panorama: Panorama, rotation: Tensor, rows: int) -> tuple[Tensor, Tensor]:
    """Return colours (3, rows, 2 rows) of a panorama turned into the map's axes, and which pixels show something."""
    color = torch.from_numpy(panorama.color).permute(2, 0, 1).float() / 255
    planes = torch.cat((color * torch.from_numpy(panorama.valid), torch.from_numpy(panorama.valid)[None].float()))
    factor = max(1, planes.shape[1] // rows)
    planes = torch.nn.functional.avg_pool2d(planes[None], factor)[0]
    height, width = planes.shape[1:]
    u, v = project(pixel_directions(rows, 2 * rows) @ rotation, height, width)
    sampled = sample_bilinear(planes, u, v).permute(2, 0, 1)
    return sampled[:3] / sampled[3:].clamp_min(1e-3), sampled[3] > 0.9


def _light(ratio: Tensor, known: Tensor) -> Tensor:
    """Return the smooth part of a log ratio (3, H, 2H) of scan to photo, over what is `known`, robust against changes."""
    height, width = known.shape
    weights = known * pixel_solid_angles(height, width)
    smooth = torch.zeros_like(ratio)
    robust = weights
    for _ in range(CHANGES.light_steps):
        sums = torch.nn.functional.avg_pool2d(torch.cat((ratio * robust, robust[None]))[None], _POOL)[0]
        wide = _blurred(sums, CHANGES.light_deg / 180 * height / _POOL)
        small = wide[:3] / wide[3:].clamp_min(1e-9)
        smooth = torch.nn.functional.interpolate(small[None], size=(height, width), mode="bilinear")[0]
        robust = weights / (1 + (color_distance(ratio - smooth) / CHANGES.half).square()).square()
    return smooth


def _blurred(image: Tensor, sigma: float) -> Tensor:
    """Blur (C, H, W) by a Gaussian of `sigma` pixels, around the seam; beyond the poles all is zero."""
    reach = min(int(3 * sigma), image.shape[2])
    kernel = (-0.5 * (torch.arange(-reach, reach + 1) / sigma).square()).exp()
    wrapped = torch.cat((image[..., -reach:], image, image[..., :reach]), dim=-1)[:, None]
    across = torch.nn.functional.conv2d(wrapped, kernel.view(1, 1, 1, -1))
    return torch.nn.functional.conv2d(across, kernel.view(1, 1, -1, 1), padding=(reach, 0))[:, 0]


def _nearest(moving: Tensor, fixed: Tensor) -> Tensor:
    """Return the least distance (H, W) of each pixel of `fixed` (3, H, W) to those within one pixel in `moving`: edges are not changes."""
    padded = wrap_border(moving)
    height, width = fixed.shape[1:]
    best = torch.full((height, width), torch.inf)
    for row in range(3):
        for column in range(3):
            best = torch.minimum(best, color_distance(padded[:, row : row + height, column : column + width] - fixed))
    return best


def _around(image: Tensor) -> Tensor:
    """Return the mean (H, W) over 3 x 3 pixels."""
    return torch.nn.functional.avg_pool2d(wrap_border(image[None])[None], 3, 1)[0, 0]


def _edges(logarithms: Tensor) -> Tensor:
    """Return the standard deviation (H, W) of logarithms of colours (3, H, W) over 3 x 3 pixels, at most 1."""
    variance = torch.stack([_around(plane.square()) - _around(plane).square() for plane in logarithms]).mean(0)
    return variance.clamp(0, 1).sqrt()
