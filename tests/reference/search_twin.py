"""Histograms, intersections, score maps and pose scores as loops over their definitions (paper, §3.1, §3.2, Eq. 1 to 4)."""

import itertools

import numpy as np
from numpy.typing import NDArray

from tests.reference.spherical_twin import patch_of

Array = NDArray[np.float64]
Table = NDArray[np.int64]


def hard_histogram(colors: Array, weights: Array, bins: int) -> Array:
    """Return the joint histogram (bins³,) of one patch: colours (S, 3) in 0..1, weights (S,); zero without a valid pixel."""
    histogram = np.zeros((bins, bins, bins))
    for color, weight in zip(colors, weights, strict=True):
        red, green, blue = (min(int(value * bins), bins - 1) for value in color)
        histogram[red, green, blue] += weight
    total = histogram.sum()
    return (histogram / total if total > 0 else histogram).ravel()


def soft_histogram(colors: Array, weights: Array, bins: int) -> Array:
    """Return the same with every pixel shared trilinearly between the centres of the bins around it."""
    histogram = np.zeros((bins, bins, bins))
    centers = (np.arange(bins) + 0.5) / bins
    for color, weight in zip(colors, weights, strict=True):
        shares = []
        for value in np.clip(color, centers[0], centers[-1]):
            shares.append(np.clip(1 - np.abs(value - centers) * bins, 0, 1))
        for red, green, blue in itertools.product(range(bins), repeat=3):
            histogram[red, green, blue] += weight * shares[0][red] * shares[1][green] * shares[2][blue]
    total = histogram.sum()
    return (histogram / total if total > 0 else histogram).ravel()


def intersections(query: Array, views: Array) -> Array:
    """Return I (T, P, P): Λ of query patch i (P, B) and patch j of view t (T, P, B)."""
    tensor = np.zeros((len(views), len(query), views.shape[1]))
    for t, i, j in np.ndindex(*tensor.shape):
        tensor[t, i, j] = sum(min(a, b) for a, b in zip(query[i], views[t, j], strict=True))
    return tensor


def patch_table(rotations: Array, rows: int, columns: int) -> Table:
    """Return π (R, P): rotate the centre of every query patch into the map's axes and look for the nearest centre there."""
    from tests.reference.spherical_twin import direction_of

    table = np.zeros((len(rotations), rows * columns), np.int64)
    for r, rotation in enumerate(rotations):
        for row, column in itertools.product(range(rows), range(columns)):
            center = direction_of(column + 0.5, row + 0.5, rows, columns)
            table[r, row * columns + column] = patch_of(rotation @ center, rows, columns)
    return table


def pose_scores(tensor: Array, table: Table, weights: Array) -> Array:
    """Return w (T, R) = Σ_i weight_i I[t, i, π_r(i)] (Eq. 4)."""
    scores = np.zeros((len(tensor), len(table)))
    for t, r in np.ndindex(*scores.shape):
        scores[t, r] = sum(weights[i] * tensor[t, i, table[r, i]] for i in range(tensor.shape[1]))
    return scores


def taken_together(values: Array, weights: Array, rows: int, columns: int) -> tuple[Array, Array]:
    """Return descriptors (T, P / 4, D) and weights (T, P / 4): weighted means over squares of two patches a side."""
    means, masses = (
        np.zeros((len(values), len(values[0]) // 4, values.shape[2])),
        np.zeros((len(values), len(values[0]) // 4)),
    )
    for t, row, column in np.ndindex(*weights.shape[:1], rows, columns):
        square = row // 2 * (columns // 2) + column // 2
        masses[t, square] += weights[t, row * columns + column]
        means[t, square] += weights[t, row * columns + column] * values[t, row * columns + column]
    return means / np.maximum(masses, 1e-9)[..., None], masses


def descriptor_scores(own: Array, weights: Array, values: Array, view_weights: Array, table: Table) -> Array:
    """Return w (T, R) = Σ_i weight_i I[t, i, π_r(i)] over the weighted standard deviation of I of each view.

    I[t, i, j] is the scalar product of descriptor i (Q, D) of a rig and patch j of view t (T, P, D). table: (R, Q).
    """
    tensor = np.zeros((len(values), len(own), values.shape[1]))
    for t, i, j in np.ndindex(*tensor.shape):
        tensor[t, i, j] = own[i] @ values[t, j]
    scores = pose_scores(tensor, table, weights)
    for t in range(len(values)):
        variance = sum(weights[i] * view_weights[t, j] * tensor[t, i, j] ** 2 for i, j in np.ndindex(*tensor.shape[1:]))
        scores[t] /= np.sqrt(variance)
    return scores


def score_map_2d(tensor: Array, table: Table) -> Array:
    """Return M (P,): the best match of every query patch in any view, turned by any rotation (Eq. 2)."""
    return np.array(
        [
            max(tensor[t, i, table[r, i]] for t in range(len(tensor)) for r in range(len(table)))
            for i in range(tensor.shape[1])
        ]
    )


def score_map_3d(tensor: Array, table: Table, points: Array, starts: Array, rows: int, columns: int) -> Array:
    """Return M_3D (N,): the mean over views of the mean match of the patch that a point projects to (Eq. 3).

    A view patch that no rotation reaches was never compared with anything; it counts as no match.
    """
    scores = np.zeros(len(points))
    for n, point in enumerate(points):
        for t, start in enumerate(starts):
            j = patch_of(point - start, rows, columns)
            met = [tensor[t, i, j] for r in range(len(table)) for i in range(table.shape[1]) if table[r, i] == j]
            scores[n] += np.mean(met) if met else 0.0
    return scores / len(starts)
