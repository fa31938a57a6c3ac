"""What a localization returns."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.camera import Camera
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Method, Status
from panoloc.core.remarks import Remark


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
class SearchSummary:
    """What was searched.

    num_maps: that were given. num_starts, over all maps, and num_poses, scored in all passes: what the hints left.
    num_rotations: of a search without hints.
    """

    method: Method
    num_maps: int
    num_starts: int
    num_rotations: int
    num_poses: int


@dataclass(frozen=True)
class Evidence:
    """What confidence and accuracy of the best candidate rest on, for those who fit or evaluate them.

    measures: the judge's figures by name. features: of the confidence. alias_margins: by how much the score
    is over that of each place that looks the same. runner_up_score: of the best candidate at another place; None
    without one.
    formal_radii: of position (metres) and orientation (degrees), by the curvature of the loss alone; None where a method gives none.
    """

    measures: Mapping[str, float]
    features: Mapping[str, float]
    alias_margins: tuple[float, ...]
    runner_up_score: float | None
    formal_radii: tuple[float, float] | None


@dataclass(frozen=True)
class FoundImage:
    """One image of a session at the best pose.

    pose: in the map's own frame. agreement: correlation of what it shows with the scan seen from there, −1..1; None where it is not
    compared, because nothing of the scan is in view, or others show the same nearer to their middle.
    """

    pose: Pose
    agreement: float | None


@dataclass(frozen=True)
class Localization:
    """The answer to one query.

    status and best: `best` is the most probable candidate, also when the status is `not_localized`; None only when
    nothing could be searched. alternatives: other candidates, best first, each elsewhere than the ones before it.
    accuracy_position_m, accuracy_orientation_deg: 68 % radii. score_pixels: works out `score_map_2d`, score_points `point_scores`.
    timings_s: seconds per stage. evidence: None without a best candidate.
    map_from_session, images: of a query of photos; `best.pose` is then that of its first image. found_cameras: of each image, where
    the answer is for other cameras than those given: of a photo whose field of view was searched, or of images that contradicted it.
    """

    status: Status
    search: SearchSummary
    timings_s: Mapping[str, float]
    best: Candidate | None = None
    alternatives: tuple[Candidate, ...] = ()
    accuracy_position_m: float | None = None
    accuracy_orientation_deg: float | None = None
    panorama_changed_fraction: float | None = None
    map_changed_fraction: float | None = None
    score_pixels: Callable[[], NDArray[np.float32]] | None = None
    score_points: Callable[[], NDArray[np.float32]] | None = None
    evidence: Evidence | None = None
    warnings: tuple[Remark, ...] = ()
    map_from_session: Pose | None = None
    images: tuple[FoundImage, ...] = ()
    found_cameras: tuple[Camera, ...] = ()

    def warned(self, *remarks: Remark) -> "Localization":
        """Return the answer with further warnings."""
        return replace(self, warnings=(*self.warnings, *remarks))

    def with_each(self, change: Callable[[Candidate], Candidate]) -> "Localization":
        """Return the answer with all candidates changed."""
        best = None if self.best is None else change(self.best)
        return replace(self, best=best, alternatives=tuple(map(change, self.alternatives)))

    @cached_property
    def score_map_2d(self) -> NDArray[np.float32] | None:
        """Return (h, w) float32 in 0..1 for the pixels of the down-scaled panorama: 1 = matches the scan, NaN = it shows nothing. None
        without a pose.

        Like `point_scores`, worked out when first asked for.
        """
        return None if self.score_pixels is None else self.score_pixels()

    @cached_property
    def point_scores(self) -> NDArray[np.float32] | None:
        """Return (N,) float32 in 0..1 for the points of the map's index, NaN for those not seen; None without a pose.

        Worked out when asked for first: no other part of an answer takes time for every point of a scan.
        """
        return None if self.score_points is None else self.score_points()
