"""The images of a rig on one sphere, as if all had been taken from one place: for pictures, and for whatever needs no more."""

import numpy as np

from panoloc.core.camera.panorama import Panorama
from panoloc.core.camera.rig import Rig
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.photo_window import photo_on_sphere


def rig_on_sphere(rig: Rig) -> tuple[Panorama, Pose]:
    """Return one panorama of all images, the rest masked, and session_from_panorama: the session's axes, the middle of the cameras."""
    spheres = [
        (photo_on_sphere(image.photo.color, image.photo.valid, image.photo.camera), image.session_from_camera)
        for image in rig.images
    ]
    rows = max(len(sphere.valid) for sphere, _ in spheres)
    if len(spheres) == 1 and np.allclose(spheres[0][1].rotation, np.eye(3)):
        return spheres[0][0], spheres[0][1]
    row, column = np.meshgrid(np.arange(rows) + 0.5, np.arange(2 * rows) + 0.5, indexing="ij")
    elevation, azimuth = np.pi / 2 - np.pi * row / rows, np.pi - np.pi * column / rows
    flat = np.cos(elevation)
    directions = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1)
    color, valid = np.zeros((rows, 2 * rows, 3), np.uint8), np.zeros((rows, 2 * rows), np.bool_)
    best = np.full(valid.shape, -2.0)
    for sphere, pose in spheres:
        height = len(sphere.valid)
        seen = directions @ pose.rotation
        r = (np.pi / 2 - np.arcsin(np.clip(seen[..., 2], -1, 1))) / np.pi * height
        c = (np.pi - np.arctan2(seen[..., 1], seen[..., 0])) / np.pi * height
        at = np.minimum(r.astype(int), height - 1), c.astype(int) % (2 * height)
        better = sphere.valid[at] & (seen[..., 0] > best)
        color[better], valid[better], best[better] = sphere.color[at][better], True, seen[..., 0][better]
    return Panorama(color, valid), rig.session_from_rig
