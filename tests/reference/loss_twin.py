"""The sampling loss of the paper (Eq. 5) as a loop over points, and rotations by their power series."""

import math

import numpy as np
from numpy.typing import NDArray

from tests.reference.spherical_twin import image_position_of, patch_of, sample

Array = NDArray[np.float64]


def turned(rotation: Array, vector: Array) -> Array:
    """Return rotation · exp([vector]×) by the power series of the exponential."""
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    term, total = np.eye(3), np.eye(3)
    for power in range(1, 25):
        term = term @ cross / power
        total = total + term
    return np.asarray(rotation @ total)


def sampling_loss(
    image: Array,
    points: Array,
    colors: Array,
    point_weights: Array,
    patch_scores: Array,
    rows: int,
    columns: int,
    rotation: Array,
    position: Array,
) -> float:
    """Return ‖½ (M_3D + S_2D) ⊙ [Γ(Π(x_camera); I) − C]‖ / √N; x_camera = rotationᵀ (x_map − position); image (H, W, 3)."""
    total = 0.0
    height, width = image.shape[:2]
    for point, color, point_weight in zip(points, colors, point_weights, strict=True):
        in_camera = rotation.T @ (point - position)
        u, v = image_position_of(in_camera, height, width)
        weight = 0.5 * (point_weight + patch_scores[patch_of(in_camera, rows, columns)])
        total += float((weight * (sample(image, u, v) - color)) @ (weight * (sample(image, u, v) - color)))
    return math.sqrt(total) / math.sqrt(len(points))
