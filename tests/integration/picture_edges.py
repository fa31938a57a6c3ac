"""How well the edges of two pictures of the same view agree, and at which shift."""

import numpy as np
from numpy.typing import NDArray


def edges(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the strength of edges (H, W) of the upper part, without the controls, smoothed over the size of a point, mean 0, length 1."""
    grey = picture[: int(0.8 * len(picture))].mean(axis=2)
    for axis in (0, 1):
        grey = np.apply_along_axis(np.convolve, axis, grey, np.ones(15) / 15, "same")
    down, right = np.gradient(grey)
    strength = np.hypot(down, right)[20:-20, 20:-20]
    strength -= strength.mean()
    return np.asarray(strength / np.linalg.norm(strength), np.float32)


def best_shift(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[tuple[int, int], float]:
    """Return the shift in pixels (rows, columns) at which two edge pictures agree most, and the correlation there."""
    agreement = np.fft.irfft2(np.fft.rfft2(first) * np.conj(np.fft.rfft2(second)), first.shape)
    row, column = np.unravel_index(np.argmax(agreement), agreement.shape)
    height, width = agreement.shape
    return (
        (int(row) - height * (row > height // 2), int(column) - width * (column > width // 2)),
        float(agreement.max()),
    )
