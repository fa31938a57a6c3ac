"""The judge, and what has changed since the scan."""

from dataclasses import dataclass


@dataclass(frozen=True)
class JudgeConfig:
    """The scan rendered at a refined pose against the panorama, and which poses differ (see `panoloc.core.decide`)."""

    # Of the score, where lines agree with a rotation no more than with any (see `panoloc.core.features.line_support`); of ones in between,
    # less.
    lines_share: float = 0.3
    # One of several images contradicts the pose of the others where the scan explains less of it than this times its contrast above noise
    # (see `panoloc.core.decide.agreement`); and the share of images that may.
    least_explained: float = 0.2
    contradicting_share: float = 0.34
    # What the tracking of several images adds to the radii of position and orientation, in quadrature: so many times its noise. With it
    # 0.66 and 0.67 of 290 right sessions are within their radii, which were fitted on none of them.
    tracking_radii: tuple[float, float] = (1.5, 1.0)
    # Images whose edges are together shorter than this show a plain wall. Of 127 photos of rooms the barest had 131 degrees, of 16 walls in
    # soft light, with and without grain, the richest 46; 20 degrees of a photo had 75 and were put elsewhere.
    least_edges_deg: float = 90.0
    sure: float = 0.9  # from which on a place is the answer, and the search ends


@dataclass(frozen=True)
class ChangeConfig:
    """What has changed since the scan (see `panoloc.core.decide.change_maps`)."""

    most_gain: float = 3.0  # between the light of scan and photo, and at least one over it
    half_score_difference: float = 0.2  # of canonical colours; the score is 0.5 there
    sampled_points: int = 50_000  # of the scan, enough for a fraction
