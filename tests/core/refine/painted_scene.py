"""A photo of a painted box, and what it shows with the colours that it has there: at the true pose nothing is left over."""

import numpy as np
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.core.panorama.photo_atlas import PhotoAtlas
from panoloc.core.panorama.photo_colors import equalized_windows
from panoloc.core.panorama.session import Session
from panoloc.core.refine.photo_points import look_directions
from panoloc.core.refine.refinement import CandidatePoints
from panoloc.core.refine.rig_level import RigLevel
from panoloc.core.refine.sphere_squares import patch_numbers
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import photo_of

POSE = Pose(rotation_of(25.0, 5.0, -3.0), np.array([1.6, 2.1, 1.4]))
ROTATION, POSITION = (torch.tensor(part, dtype=torch.float32)[None] for part in (POSE.rotation, POSE.position))


def photo_with_points(box: PaintedBox) -> tuple[RigLevel, CandidatePoints]:
    """Return the level of a photo of a box, and the points that it shows, in patches of 15 degrees."""
    atlas = PhotoAtlas(
        Session.of_photo(photo_of(box, Camera.from_hfov("pinhole", 640, 480, 80.0), POSE)), 512, None, "cpu"
    )
    windows = atlas.windows(128)
    level = RigLevel(windows.level(equalized_windows(windows)), atlas.rotations, atlas.centers)
    look = look_directions(atlas, 2000, 0.0).directions
    patches, order = patch_numbers(look, 15.0).sort(stable=True)
    look = look[order]
    place = torch.tensor(box.points_along(POSE.position, look.double().numpy() @ POSE.rotation.T), dtype=torch.float32)
    seen, inside = level.sample_points(place.T[None], None, ROTATION, POSITION)
    colors = seen.color.transpose(1, 2).clone()
    return level, CandidatePoints(place[None], colors, inside.float(), None, patches)
