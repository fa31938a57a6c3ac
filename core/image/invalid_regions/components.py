"""Connected components of a small mask, and the neighbourhood of each."""

import numpy as np
from numpy.typing import NDArray

Labels = NDArray[np.int64]


def connected_components(mask: NDArray[np.bool_], wraps: bool) -> Labels:
    """Return labels (h, w): 0 outside the mask, else the number of the component, side by side or above each other.

    wraps: the last column is beside the first.
    """
    height, width = mask.shape
    number = np.arange(height * width).reshape(height, width)
    across = mask & np.roll(mask, -1, axis=1)
    if not wraps:
        across[:, -1] = False
    down = mask[:-1] & mask[1:]
    first = np.concatenate((number[across], number[:-1][down]))
    second = np.concatenate((np.roll(number, -1, axis=1)[across], number[1:][down]))
    root = np.arange(height * width)
    while True:
        a, b = root[first], root[second]
        if (a == b).all():
            break
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while True:
            higher = root[root]
            if (higher == root).all():
                break
            root = higher
    labels = np.zeros(mask.shape, np.int64)
    labels[mask] = np.unique(root[mask.ravel()], return_inverse=True)[1] + 1
    return labels


def grown(labels: Labels, wraps: bool) -> Labels:
    """Return labels (h, w) that reach one cell further in all eight directions, over what has none."""
    padded = np.pad(labels, ((1, 1), (0, 0)))
    padded = np.pad(padded, ((0, 0), (1, 1)), mode="wrap" if wraps else "constant")
    across = np.maximum(np.maximum(padded[:, :-2], padded[:, 1:-1]), padded[:, 2:])
    around = np.maximum(np.maximum(across[:-2], across[1:-1]), across[2:])
    return np.where(labels > 0, labels, around)


def spread(mask: NDArray[np.bool_], reach: int, wraps: bool) -> NDArray[np.bool_]:
    """Return the mask (h, w) with everything up to `reach` rows and columns away."""
    out = mask
    for axis in (0, 1):
        wide = out.copy()
        for by in range(1, reach + 1):
            if axis == 0:
                wide[by:] |= out[:-by]
                wide[:-by] |= out[by:]
            else:
                wide[:, by:] |= out[:, :-by]
                wide[:, :-by] |= out[:, by:]
                if wraps:
                    wide[:, :by] |= out[:, -by:]
                    wide[:, -by:] |= out[:, :by]
        out = wide
    return out
