"""What changed at a pose, as loops over pixels."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def neighbours(row: int, column: int, height: int, width: int) -> list[tuple[int, int]]:
    """Return the 3 x 3 pixels around one; over a pole the image goes on on the opposite meridian."""
    found = []
    for r in (row - 1, row, row + 1):
        for c in (column - 1, column, column + 1):
            if r < 0:
                found.append((-1 - r, (c + width // 2) % width))
            elif r >= height:
                found.append((2 * height - 1 - r, (c + width // 2) % width))
            else:
                found.append((r, c % width))
    return found


def fitted_light(panorama: Array, scan: Array, weights: Array) -> Array:
    """Return the panorama (S, 3) with the gain and offset per channel that bring it nearest to the scan."""
    share = weights / weights.sum()
    fitted = np.zeros_like(panorama)
    for channel in range(3):
        source, target = panorama[:, channel], scan[:, channel]
        middle, wanted = share @ source, share @ target
        slope = (share @ ((source - middle) * (target - wanted)) + 1e-3) / (share @ (source - middle) ** 2 + 1e-3)
        fitted[:, channel] = (source - middle) * np.clip(slope, 0.3, 3.0) + wanted
    return fitted


def pixel_scores(scan: Array, panorama: Array, weights: Array, half: float) -> Array:
    """Return scores (H, W) of images (H, W, 3) with weights (H, W); a colour distance of `half` to the best pixel nearby scores 0.5."""
    height, width, _ = scan.shape
    robust = weights.ravel()
    for _ in range(3):
        fitted = fitted_light(panorama.reshape(-1, 3), scan.reshape(-1, 3), robust)
        distance = np.linalg.norm(fitted - scan.reshape(-1, 3), axis=1) / half
        robust = weights.ravel() / (1 + distance**2) ** 2
    nearby = fitted.reshape(scan.shape)
    sharp = np.zeros((height, width))
    for row, column in np.ndindex(height, width):
        distances = [np.linalg.norm(nearby[p] - scan[row, column]) for p in neighbours(row, column, height, width)]
        sharp[row, column] = 1 / (1 + (min(distances) / half) ** 2)
    scores = np.zeros((height, width))
    for row, column in np.ndindex(height, width):
        scores[row, column] = np.mean([sharp[p] for p in neighbours(row, column, height, width)])
    return scores
