"""A change as a person sees it: the photo and the scan, side by side, in the direction of the object."""

import io

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import project, sample_bilinear
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import render_views

SIDE_PX = 320
_ROWS = 512  # of the sphere that the scan is rendered on
_MARGIN = 1.5  # of the object's own angle
_LEAST_RAD, _MOST_RAD = 0.25, 1.0  # half of what is shown
_GAP = 4


def crop_pair(
    cloud: RenderCloud,
    panorama: Panorama,
    cloud_from_camera: Pose,
    low: NDArray[np.floating],
    high: NDArray[np.floating],
) -> Image.Image:
    """Return the photo (left) and the scan from the same place (right), both towards the box from `low` to `high`, which is outlined."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    relative = corners - cloud_from_camera.position
    axis = (low + high) / 2 - cloud_from_camera.position
    axes = _looking_along(axis / max(float(np.linalg.norm(axis)), 1e-6))
    directions = relative / np.maximum(np.linalg.norm(relative, axis=1, keepdims=True), 1e-6)
    half = float(np.clip(_MARGIN * np.arccos(np.clip(directions @ axes[0], -1, 1)).max(), _LEAST_RAD, _MOST_RAD))
    rays = _rays(axes, half)
    view = render_views(cloud, torch.from_numpy(cloud_from_camera.position).float()[None], _ROWS, with_points=False)
    scan = view.color[0] * view.valid[0][..., None]
    color = torch.from_numpy(panorama.color).float() / 255 * torch.from_numpy(panorama.valid)[..., None]
    photo_rays = rays @ torch.from_numpy(cloud_from_camera.rotation).float()
    together = Image.new("RGB", (2 * SIDE_PX + _GAP, SIDE_PX), "white")
    outline = _outline(relative @ axes.T, half)
    for column, (image, towards) in enumerate(((color, photo_rays), (scan, rays))):
        u, v = project(towards, *image.shape[:2])
        pixels = (sample_bilinear(image.permute(2, 0, 1), u, v).clamp(0, 1) * 255).byte().numpy()
        shown = Image.fromarray(pixels)
        if outline is not None:
            ImageDraw.Draw(shown).rectangle(outline, outline=(224, 43, 36), width=2)
        together.paste(shown, (column * (SIDE_PX + _GAP), 0))
    return together


def encode_jpeg(picture: Image.Image) -> bytes:
    """Return a picture as the bytes of a JPEG."""
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=85)
    return buffer.getvalue()


def _looking_along(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the axes forward, left, up (3, 3) of a level camera."""
    left = np.cross((0.0, 0.0, 1.0), axis)
    left = left / np.linalg.norm(left) if np.linalg.norm(left) > 1e-3 else np.array([0.0, 1.0, 0.0])
    return np.stack((axis, left, np.cross(axis, left)))


def _rays(axes: NDArray[np.float64], half: float) -> torch.Tensor:
    """Return the directions (SIDE_PX, SIDE_PX, 3) of the pixels of a picture that shows `half` radians to each side."""
    across = np.tan(half) * (1 - 2 * (np.arange(SIDE_PX) + 0.5) / SIDE_PX)
    z, y = np.meshgrid(across, across, indexing="ij")
    return torch.from_numpy(np.stack((np.ones_like(y), y, z), -1) @ axes).float()


def _outline(corners: NDArray[np.float64], half: float) -> tuple[float, float, float, float] | None:
    """Return the rectangle around corners (8, 3) in the camera's axes, pixels; None where one lies beside or behind."""
    if corners[:, 0].min() < 0.1:
        return None
    scale = SIDE_PX / 2 / np.tan(half)
    u, v = (SIDE_PX / 2 - scale * corners[:, k] / corners[:, 0] for k in (1, 2))
    left, top = max(1.0, float(u.min())), max(1.0, float(v.min()))
    right, bottom = min(SIDE_PX - 2.0, float(u.max())), min(SIDE_PX - 2.0, float(v.max()))
    return (left, top, right, bottom) if right > left and bottom > top else None
