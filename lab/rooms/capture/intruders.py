"""People in the picture: somebody standing near the camera, or the hand that holds it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.rig import Panorama
from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms.capture.views import pixel_centers, viewing_directions
from panoloc.lab.rooms.materials.artwork import random_rgb
from panoloc.lab.rooms.objects.decoration import person
from panoloc.lab.rooms.objects.objects import Footprint, placed
from panoloc.lab.rooms.scenes.scene import Scene

_TRIES = 30
_STANDING_ROOM_M = 0.22


def add_person(scene: Scene, pose: Pose, seed: int = 0) -> Scene:
    """Return the scene with somebody standing 0.7 to 2 m from the camera; the same scene where there is no room."""
    rng = np.random.default_rng((seed, 5))
    for _ in range(_TRIES):
        angle, distance = rng.uniform(-np.pi, np.pi), rng.uniform(0.7, 2.0)
        x, y = pose.position[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
        inside = any(room.x0 < x < room.x1 and room.y0 < y < room.y1 for room in scene.rooms)
        column = np.array([(x, y, z) for z in (0.4, 0.8, 1.2, 1.6)])
        if inside and scene.surface.clearance(column).min() > _STANDING_ROOM_M:
            area = Footprint(x - 0.3, y - 0.3, x + 0.3, y + 0.3)
            yaw = float(angle + np.pi / 2 + rng.normal(0, 0.5))
            somebody = placed(person(rng), f"person@{x:.3f},{y:.3f}", yaw, (x, y, 0.0), area)
            return replace(scene, objects=(*scene.objects, somebody), exposed_like=scene)
    return scene


def show_hand(panorama: Panorama, seed: int = 0) -> tuple[Panorama, NDArray[np.bool_]]:
    """Return the panorama with a hand and sleeve below the camera, and the (H, W) mask of what they cover."""
    rng = np.random.default_rng((seed, 6))
    height, width = panorama.valid.shape
    directions = viewing_directions(*pixel_centers(width), width)
    heading = rng.uniform(-np.pi, np.pi)
    along, across = np.array([np.cos(heading), np.sin(heading), 0]), np.array([-np.sin(heading), np.cos(heading), 0])
    below = directions[:, 2] < -0.2
    depth = np.maximum(-directions[:, 2], 1e-3)
    # Coordinates on a plane one unit below the camera.
    a, b = directions @ along / depth, directions @ across / depth
    wobble = 0.04 * np.sin(9 * a) + 0.03 * np.sin(5 * np.arctan2(b, a))
    fist = below & (np.hypot(a, b * 1.2) < rng.uniform(0.3, 0.45) + wobble)
    arm = below & (a > 0) & (a < 2.4) & (np.abs(b) < 0.2 + 0.08 * a + wobble / 2)
    skin, sleeve = (np.array(random_rgb(rng, 0.45, (0.5, 0.95), hue=0.06)), np.array(random_rgb(rng, 0.8, (0.1, 0.8))))
    shading = (1 - 0.35 * np.abs(np.sin(6 * b + 2 * a)) - 0.3 * np.clip(np.hypot(a, b) - 0.5, 0, 1))[:, None]
    pixels = panorama.color.reshape(-1, 3).copy()
    for mask, color in ((arm, np.where((a > 0.9)[:, None], sleeve, skin)), (fist, skin)):
        painted = np.broadcast_to(color, pixels.shape) * shading
        pixels[mask] = np.clip(painted[mask], 0, 255).astype(np.uint8)
    covered = (fist | arm).reshape(height, width)
    return Panorama(pixels.reshape(height, width, 3), panorama.valid), covered
