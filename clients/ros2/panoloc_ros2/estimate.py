"""Where `odom` lies in `map`, and how sure that is: answers weighed against odometry, and outliers rejected."""

import math
from dataclasses import dataclass
from typing import Literal

from .poses import Pose, distance_between

_RADIUS = 1.872  # of a ball that holds 68 % of a normal distribution in three dimensions, in standard deviations
_GATE = 4.0  # standard deviations: one of a thousand right answers lies farther off
# Of the heading, where a metre adds 1 to the position: radians per metre, and per radian, which gyroscopes measure well.
_DRIFT_PER_M, _DRIFT_PER_RAD = 0.2, 0.4

Verdict = Literal["first", "corrected", "moved", "doubted"]


@dataclass(frozen=True)
class Travel:
    """How far the odometry has gone, and turned, in all."""

    distance_m: float = 0.0
    turn_rad: float = 0.0

    def since(self, other: "Travel") -> "Travel":
        """Return what was travelled between two readings, in either order."""
        return Travel(abs(self.distance_m - other.distance_m), abs(self.turn_rad - other.turn_rad))

    def shows_more_than(self, other: "Travel") -> bool:
        """Tell whether the way or the turn is as far as the other's."""
        return self.distance_m >= other.distance_m or self.turn_rad >= other.turn_rad


@dataclass(frozen=True)
class Spread:
    """Standard deviations of each coordinate and of the rotation about each axis."""

    position_m: float
    angle_rad: float

    @property
    def angle_deg(self) -> float:
        """Return the angle in degrees."""
        return math.degrees(self.angle_rad)

    @property
    def covariance(self) -> list[float]:
        """Return the 36 numbers of a PoseWithCovariance, row by row."""
        variances = [self.position_m**2] * 3 + [self.angle_rad**2] * 3
        return [variances[row] if row == column else 0.0 for row in range(6) for column in range(6)]

    def after(self, way: Travel, drift: float) -> "Spread":
        """Return the spread after more travel. drift: error of the odometry as a share of the way."""
        position = math.hypot(self.position_m, drift * way.distance_m, self.angle_rad * way.distance_m)
        heading = drift * (_DRIFT_PER_M * way.distance_m + _DRIFT_PER_RAD * way.turn_rad)
        return Spread(position, math.hypot(self.angle_rad, heading))


ANOTHER_VIEW = Travel(0.5, math.radians(25.0))
"""From which way, or which turn, on a camera shows something else."""
# The camera is never mounted, nor the clocks set, more exactly. What agrees again and again makes nothing surer than this.
_LEAST = Spread(0.02, math.radians(0.5))


@dataclass(frozen=True)
class Measurement:
    """An answer: map_from_odom, how sure it is, and the travel at its first frame."""

    map_from_odom: Pose
    spread: Spread
    travel: Travel
    confidence: float

    @classmethod
    def of_accuracy(
        cls, map_from_odom: Pose, accuracy: dict[str, float], travel: Travel, confidence: float
    ) -> "Measurement":
        """Return the measurement with the radii of an answer."""
        position_m = math.hypot(accuracy["position_m"] / _RADIUS, _LEAST.position_m)
        angle_rad = math.hypot(math.radians(accuracy["orientation_deg"]) / _RADIUS, _LEAST.angle_rad)
        return cls(map_from_odom, Spread(position_m, angle_rad), travel, confidence)


class Estimate:
    """What is known by now. drift: as in Parameters. min_confidence: from which one answer is enough at first."""

    def __init__(self, drift: float, min_confidence: float) -> None:
        self._drift, self._min_confidence = drift, min_confidence
        self._current: Measurement | None = None
        self._doubted: Measurement | None = None

    @property
    def map_from_odom(self) -> Pose | None:
        """Return the estimate, None before the first."""
        return None if self._current is None else self._current.map_from_odom

    @property
    def is_doubted(self) -> bool:
        """Return whether an answer contradicts the estimate and waits for a second one."""
        return self._doubted is not None

    def spread_at(self, travel: Travel) -> Spread:
        """Return how sure the robot's pose is by now; the estimate must be known."""
        assert self._current is not None
        return self._at(self._current, travel)

    def take(self, found: Measurement, odom_from_base: Pose, travel: Travel) -> Verdict:
        """Weigh an answer. odom_from_base, travel: of now."""
        current, doubted = self._current, self._doubted
        # From one place, errors are alike.
        is_another = doubted is not None and found.travel.since(doubted.travel).shows_more_than(ANOTHER_VIEW)
        if current is not None and self._agree(current, found, odom_from_base, travel):
            self._current, self._doubted = self._blend(current, found, odom_from_base, travel), None
            return "corrected"
        is_sure = current is None and found.confidence >= self._min_confidence
        if not is_sure and not (is_another and doubted and self._agree(doubted, found, odom_from_base, travel)):
            self._doubted = found if is_another or doubted is None else doubted
            return "doubted"
        self._current, self._doubted = found, None
        return "first" if current is None else "moved"

    def _at(self, each: Measurement, travel: Travel) -> Spread:
        return each.spread.after(travel.since(each.travel), self._drift)

    def _agree(self, a: Measurement, b: Measurement, odom_from_base: Pose, travel: Travel) -> bool:
        """Tell whether two put the robot at one place, as far as they can know."""
        moved_m, turned_rad = distance_between(a.map_from_odom @ odom_from_base, b.map_from_odom @ odom_from_base)
        first, second = self._at(a, travel), self._at(b, travel)
        is_near = moved_m < _GATE * math.hypot(first.position_m, second.position_m)
        return is_near and turned_rad < _GATE * math.hypot(first.angle_rad, second.angle_rad)

    def _blend(self, a: Measurement, b: Measurement, odom_from_base: Pose, travel: Travel) -> Measurement:
        """Return both as one, weighed by their variances where the robot is: far from the origin of `odom` an angle moves much."""
        first, second = self._at(a, travel), self._at(b, travel)
        share, turn_share = (
            one**2 / (one**2 + other**2)
            for one, other in ((first.position_m, second.position_m), (first.angle_rad, second.angle_rad))
        )
        map_from_base = (a.map_from_odom @ odom_from_base).moved_towards(
            b.map_from_odom @ odom_from_base, share, turn_share
        )
        spread = Spread(
            max(second.position_m * math.sqrt(share), _LEAST.position_m),
            max(second.angle_rad * math.sqrt(turn_share), _LEAST.angle_rad),
        )
        return Measurement(map_from_base @ odom_from_base.inverse(), spread, travel, b.confidence)
