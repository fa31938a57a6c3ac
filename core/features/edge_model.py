"""What an edge is expected to do: run along one of three axes, give or take some noise, or anywhere.

Source: Coughlan and Yuille, *Manhattan World*, ICCV 1999.
"""

import math

from torch import Tensor

LEAST_SINE = 0.05  # of the angle from an edge to a vanishing point; nearer ones say nothing of the direction of an edge


def alignment_ratio(off_square: Tensor, noise: float, aligned_share: float) -> Tensor:
    """Return how much likelier edges are along an axis than anywhere, of any shape.

    off_square: squared angles between edges and the way to the vanishing point of the axis, radians; noise: their standard deviation,
    radians. aligned_share: of all edges, that are along one of three axes. Edges that run anywhere have the density 1 / π.
    """
    peak = aligned_share / 3 * math.pi / (noise * math.sqrt(2 * math.pi)) / (1 - aligned_share)
    return (off_square * (-0.5 / noise**2)).exp() * peak
