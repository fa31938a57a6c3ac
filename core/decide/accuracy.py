"""How far off a pose may be: 68 % radii, and how sure they allow it to be right."""

import math
from dataclasses import dataclass

from panoloc.core.config import DISTANCES

_HELD = 0.68  # of the poses are within their radii


@dataclass(frozen=True)
class Accuracy:
    """68 % radii: position (metres) and orientation (degrees); None where a method gives no curvature."""

    position_m: float | None
    orientation_deg: float | None

    def with_noise(self, noise: "Accuracy") -> "Accuracy":
        """Return the radii with further errors, in quadrature."""
        if self.position_m is None or self.orientation_deg is None:
            return self
        position_m = math.hypot(self.position_m, noise.position_m or 0.0)
        return Accuracy(position_m, min(math.hypot(self.orientation_deg, noise.orientation_deg or 0.0), 180.0))

    @property
    def share_right(self) -> float:
        """Return the share of poses with these radii that are right, errors being normal in the plane; 1 where a radius is not known.

        Nothing is surer to be right than its radius allows.
        """
        right = DISTANCES.right
        known = ((right.distance_m, self.position_m), (right.angle_deg, self.orientation_deg))
        shares = [1 - (1 - _HELD) ** ((limit / radius) ** 2) for limit, radius in known if radius]
        return min(shares, default=1.0)


NO_NOISE = Accuracy(0.0, 0.0)
