"""What refinement is tried on, at poses at which nothing is left over: a photo of a painted box, and a painted sphere."""

from functools import cache

import numpy as np
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Photo, Session
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixel_directions
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.image.photo_colors import equalized_windows
from panoloc.core.refine.photo_points import look_directions
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.rig_level import RigLevel
from panoloc.core.refine.sphere_squares import patch_numbers
from tests.core.built_maps import tensors_of
from tests.core.found_pose import known
from tests.core.image.painted_photos import photo_of
from tests.core.painted_box import PaintedBox, rotation_of

CAMERA = Camera.from_hfov("pinhole", 640, 480, 80.0)
POSE = Pose(rotation_of(25.0, 5.0, -3.0), np.array([1.6, 2.1, 1.4]))
ROTATION, POSITION = tensors_of(POSE)
Scene = tuple[RigLevel, CandidatePoints]


def level_of(box: PaintedBox, camera: Camera = CAMERA) -> tuple[RigLevel, PhotoAtlas]:
    """Return the level of a photo of a box, taken for one of a camera, and its atlas."""
    photo = photo_of(CAMERA, POSE, box)
    atlas = PhotoAtlas(Session.of_photo(Photo(photo.color, photo.valid, camera)), 512, None, "cpu")
    windows = atlas.windows(128)
    return RigLevel(windows.level(equalized_windows(windows)), atlas.rotations, atlas.centers), atlas


@cache
def scene(seed: int = 3) -> Scene:
    """Return the level of a photo of a box, and the points that it shows in their own colours, in patches of 15 degrees."""
    box = PaintedBox(seed=seed)
    level, atlas = level_of(box)
    look = look_directions(atlas, 2000, 0.0).directions
    patches, order = patch_numbers(look, 15.0).sort(stable=True)
    look = look[order]
    place = torch.tensor(box.points_along(POSE.position, look.double().numpy() @ POSE.rotation.T), dtype=torch.float32)
    seen, inside = level.sample_points(place.T[None], None, ROTATION, POSITION)
    return level, CandidatePoints(place[None], seen.color.transpose(1, 2).clone(), inside.float(), None, patches)


def patches_of(points: CandidatePoints) -> torch.Tensor:
    return known(points.patches)


def painted(directions: torch.Tensor) -> torch.Tensor:
    """Return smooth colours (..., 3) of directions (..., 3)."""
    x, y, z = directions.unbind(-1)
    return 0.5 + 0.3 * torch.stack(((3 * x + 2 * y).sin(), (4 * y - z).sin(), (3 * z + x).cos()), dim=-1)


def painted_sphere(height: int) -> torch.Tensor:
    """Return the panorama (3, H, W) of such colours."""
    return painted(pixel_directions(height, 2 * height)).permute(2, 0, 1).contiguous()


def at_distances(directions: torch.Tensor, seed: int = 1) -> torch.Tensor:
    """Return points (N, 3) along directions (N, 3), 1 to 4 m away."""
    return directions * (1 + 3 * torch.rand((len(directions), 1), generator=torch.Generator().manual_seed(seed)))
