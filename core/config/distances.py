"""How far apart poses are one, beside each other, or at other places."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PoseDistance:
    """Two poses that are nearer to each other than both of these are one."""

    distance_m: float
    angle_deg: float


@dataclass(frozen=True)
class PoseDistances:
    """The distances that poses are told apart by, at every step of a query alike."""

    same: PoseDistance = PoseDistance(0.1, 3.0)  # what refinement brings so near to each other is one pose
    place: PoseDistance = PoseDistance(0.5, 15.0)  # beyond it poses are different candidates, and different answers
    right: PoseDistance = PoseDistance(0.3, 10.0)  # nearer to the true pose than that, a pose is right
    elsewhere: PoseDistance = PoseDistance(1.5, 30.0)  # beyond it what looks the same is no view from beside a place


DISTANCES = PoseDistances()
