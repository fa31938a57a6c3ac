"""What a localization returns, and the hints that narrow it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.geometry.pose import Pose

Method = Literal["fast", "paper"]
Status = Literal["localized", "ambiguous", "not_localized"]


@dataclass(frozen=True)
class Hints:
    """What the caller knows beforehand; every field narrows the search and is never exceeded by the answer.

    position: (x, y, z) in the map's own frame, metres, with `radius_m` around it.
    region: ((min x, y, z), (max x, y, z)) in the map's own frame, metres.
    upright: the camera is level within `max_tilt_deg` (default 15 where only `upright` is given).
    heading_deg: yaw of the image centre, counter-clockwise about z from +x, within `heading_tolerance_deg`.
    """

    position_m: tuple[float, float, float] | None = None
    radius_m: float | None = None
    region: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    upright: bool = False
    max_tilt_deg: float | None = None
    heading_deg: float | None = None
    heading_tolerance_deg: float | None = None


@dataclass(frozen=True)
class Candidate:
    """One refined pose and how well it explains the panorama.

    pose: in the map's own frame (origin offset added). map_position: which of the given maps.
    score: what the judge ranks by (larger is better); sampling_loss: the paper's loss (smaller is better).
    """

    pose: Pose
    map_position: int
    confidence: float
    score: float
    sampling_loss: float
    color_model: str
    num_iterations: int


@dataclass(frozen=True)
class Localization:
    """The answer to one query.

    status and best: `best` is the most probable candidate, also when the status is `not_localized`; None only when
    nothing could be searched. alternatives: other candidates, best first, each elsewhere than the ones before it.
    accuracy_position_m, accuracy_orientation_deg: 68 % radii. score_map_2d: (h, w) float32 in 0..1, per pixel of the
    down-scaled panorama, 1 = matches the scan. score_points: works out `point_scores`.
    timings_s: seconds per stage. search: counts and figures for the caller's log (JSON-safe values).
    """

    status: Status
    best: Candidate | None
    alternatives: tuple[Candidate, ...]
    accuracy_position_m: float | None
    accuracy_orientation_deg: float | None
    panorama_changed_fraction: float | None
    map_changed_fraction: float | None
    score_map_2d: NDArray[np.float32] | None
    score_points: Callable[[], NDArray[np.float32]] | None
    timings_s: dict[str, float]
    search: dict[str, Any]
    warnings: tuple[str, ...] = field(default=())

    @cached_property
    def point_scores(self) -> NDArray[np.float32] | None:
        """Return (N,) float32 in 0..1 for the points of the map's index, NaN for those not seen; None without a pose.

        Worked out when asked for first: no other part of an answer takes time for every point of a scan.
        """
        return None if self.score_points is None else self.score_points()
