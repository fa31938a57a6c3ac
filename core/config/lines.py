"""Edges of photos, and what they say of how the camera is turned."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LineConfig:
    """Edges, and the lines that they are of (see `panoloc.core.features.line_support`)."""

    squares: int = 512  # that photos are divided into
    edges_in_square: int = 3  # the strongest
    edge_over_noise: float = 3.0  # how much faster than in half of the photo colours change there
    least_gradient: float = 0.5  # of the logarithm of colours, per radian: less than one step of eight bits
    edge_noise_deg: float = 1.5  # of the direction of an edge
    aligned_share: float = 0.6  # of the edges, that are along an axis
    support_rows: int = 90  # of the map of vanishing points
    # Lines are not asked where the best rotation is hardly better than rotations by chance (mean logarithm of the likelihood ratio of an
    # edge).
    least_contrast: float = 0.2
