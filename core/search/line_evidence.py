"""What the edges of photos say of how they are turned in one map, and how much that is worth."""

import math

import torch
from torch import Tensor

from panoloc.core.config import PoseDistance, SearchConfig
from panoloc.core.features.line_support import LineSupport
from panoloc.core.geometry.distinct_poses import first_distinct
from panoloc.core.geometry.rotations import rotation_spacing, rotations_of
from panoloc.core.search.pose_limits import PoseLimits


class LineEvidence:
    """Edges of photos against the walls of a map.

    contrast: by how much edges agree better with the best rotation, of those that the limits allow where they bound the tilt, than with
    rotations by chance: mean logarithm of the likelihood ratio of an edge. What is dense enough is 3.5 degrees apart.
    """

    def __init__(self, lines: LineSupport, axes_from_map: Tensor, limits: PoseLimits, config: SearchConfig) -> None:
        self._lines, self._axes_from_map, self._config = lines, axes_from_map, config
        # Rotations map_from_rig, of which one is near any.
        self._every = rotations_of(config.line_rotations, str(axes_from_map.device))
        self._by_chance = lines.by_chance
        if limits.leaves_tilts_beyond(math.pi / 2):
            self.contrast = lines.contrast(len(self._every))
        else:
            allowed = self._every[limits.allows_rotation(self._every)]
            best = self.of_rotations(allowed).max() if len(allowed) else torch.tensor(self._by_chance)
            self.contrast = float(best) - self._by_chance

    def of_rotations(self, rotations: Tensor) -> Tensor:
        """Return how well edges agree with rotations (R, 3, 3) map_from_rig: the mean logarithm of the likelihood ratio (R,)."""
        return self._lines.of_rotations(self._axes_from_map @ rotations)

    def missed(self, rotations: Tensor) -> Tensor:
        """Return how far rotations (R, 3, 3) fall short of the best one: 0, not at all, to 1, no better than by chance."""
        return 1 - ((self.of_rotations(rotations) - self._by_chance) / max(self.contrast, 1e-6)).clamp(0, 1)

    def likely_rotations(self, limits: PoseLimits) -> Tensor:
        """Return the rotations (L, 3, 3) within the limits that edges agree with best, some degrees apart."""
        allowed = self._every[limits.allows_rotation(self._every, rotation_spacing(len(self._every)) / 2)]
        count = min(len(allowed), self._config.likely_rotations)
        best = allowed[self.of_rotations(allowed).topk(count).indices]
        apart = PoseDistance(1.0, self._config.likely_apart_deg)
        distinct = first_distinct(best, torch.zeros_like(best[:, 0]), apart)
        return best[torch.tensor(distinct, dtype=torch.long, device=best.device)]
