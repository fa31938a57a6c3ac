"""What refinement is tried on, at poses at which nothing is left over: a photo of a painted box, and a painted sphere."""

from functools import cache

import numpy as np
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.image.level import Level
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.refine.aligned_points import look_directions
from panoloc.core.refine.step import PointPlanes
from tests.core.built_maps import tensors_of
from tests.core.image.painted_photos import photo_of
from tests.core.painted_box import PaintedBox, rotation_of

CAMERA = Camera.from_hfov("pinhole", 640, 480, 80.0)
POSE = Pose(rotation_of(25.0, 5.0, -3.0), np.array([1.6, 2.1, 1.4]))
ROTATION, POSITION = tensors_of(POSE)
Scene = tuple[Level, PointPlanes]


def level_of(box: PaintedBox, camera: Camera = CAMERA) -> tuple[Level, RigPyramid]:
    """Return the level of a photo of a box, taken for one of a camera, and its pyramid."""
    photo = photo_of(CAMERA, POSE, box)
    pyramid = RigPyramid(Rig.of_photo(Photo(photo.color, photo.valid, camera)), 512, None, "cpu")
    return CanonicalColors(pyramid).level(256, 0.0), pyramid


@cache
def scene(seed: int = 3) -> Scene:
    """Return the level of a photo of a box, and the points that it shows in their own colours, in patches of 15 degrees."""
    box = PaintedBox(seed=seed)
    level, pyramid = level_of(box)
    look = look_directions(pyramid, 2000, 0.0, 15.0)
    along = look.directions.double().numpy() @ POSE.rotation.T
    place = torch.tensor(box.points_along(POSE.position, along), dtype=torch.float32)
    seen, inside = level.sample_points(place.T[None], None, ROTATION, POSITION)
    return level, PointPlanes.of_triples(
        place[None], seen.color.transpose(1, 2).clone(), inside.float(), None, look.patches
    )


def painted(directions: torch.Tensor) -> torch.Tensor:
    """Return smooth colours (..., 3) of directions (..., 3)."""
    x, y, z = directions.unbind(-1)
    return 0.5 + 0.3 * torch.stack(((3 * x + 2 * y).sin(), (4 * y - z).sin(), (3 * z + x).cos()), dim=-1)


def painted_sphere(height: int) -> torch.Tensor:
    """Return the panorama (3, H, W) of such colours."""
    return painted(pixel_directions(height, 2 * height)).permute(2, 0, 1).contiguous()


def level_of_sphere(image: torch.Tensor, valid: torch.Tensor | None = None) -> Level:
    """Return the level of a panorama (3, H, W) of which the pixels `valid` (H, W) count, all where that is None."""
    height, width = image.shape[1:]
    mask = np.ones((height, width), np.bool_) if valid is None else valid.bool().numpy()
    blank = Panorama(np.full((height, width, 3), 90, np.uint8), mask)
    windows = RigPyramid(Rig.of_panorama(blank), height, None, "cpu").windows(height)
    return windows.level(windows.packed([image]))


def at_distances(directions: torch.Tensor, seed: int = 1) -> torch.Tensor:
    """Return points (N, 3) along directions (N, 3), 1 to 4 m away."""
    return directions * (1 + 3 * torch.rand((len(directions), 1), generator=torch.Generator().manual_seed(seed)))
