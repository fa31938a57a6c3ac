"""The search over starts and rotations."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PoseDistance:
    """Two poses that are nearer to each other than both of these are one."""

    distance_m: float
    angle_deg: float


@dataclass(frozen=True)
class SearchConfig:
    """Rounds of search (see `panoloc.core.query.rounds`). What a round looks at follows from the share of the sphere that a rig covers."""

    # Rigs that cover at least this share are described by patches of 22 degrees, which tell them apart at a fiftieth of the cost; a first
    # pass by patches twice as large discards most starts.
    wide_share: float = 0.6
    first_rotations: int = 576
    wide_rotations: int = 2304  # spacing about 18 degrees, within the basin of refinement
    kept_share: float = 1 / 3  # of the starts; the right one was among the first 0.23 wherever it is found
    kept_starts: int = 128  # never fewer
    # Others by patches of 11 degrees.
    narrow_rotations: int = 9216  # spacing about 11 degrees
    dense_rotations: int = 36_864  # spacing about 7 degrees, where limits leave at most `most_dense` of them
    most_dense: int = 12_000
    most_patches: int = 64  # that are compared; six frames show 160, and so many of them rank as well
    # The poses that patches like best are scored again by pixels, all together so many.
    rescored_pixels: int = 1_000_000
    wide_rescored_pixels: int = 200_000
    histogram_weight: float = 0.04  # of the score by patches, added to that by pixels (docs/experiments.md)
    square_pixels: int = 4  # of a picture, on each side of the squares in which correlation is measured
    min_variance: float = 4e-3  # of equalized colours in a square; below it contrast is noise
    # Of starts and rotations, beyond what limits allow: half the spacing of either.
    margin_m: float = 0.5
    wide_margin_deg: float = 12.0
    narrow_margin_deg: float = 6.0
    # People hold cameras level: poses tilted no more than this are searched first.
    level_tilt_deg: float = 18.0
    # Lines say how a camera is turned (see `panoloc.core.search.line_evidence`). Of so many rotations, 3.5 degrees apart, this share is
    # searched first, the best of it so far apart; of their poses so many are scored by patches, and pixels of the best of these again.
    line_rotations: int = 294_912
    line_margin_deg: float = 2.0
    likely_share: float = 0.02
    fewest_likely: int = 64
    most_likely: int = 600
    likely_apart_deg: float = 4.0
    likely_described_poses: int = 5000
    likely_histogram_weight: float = 0.08
    likely_rescored_pixels: int = 250_000
    # The best of these are scored once more at places around their starts (see `panoloc.core.search.position_sweep`), and the first of them
    # on finer pictures at places around those; all places together have so many pixels.
    swept: int = 80
    swept_distinct: PoseDistance = PoseDistance(0.4, 10.0)
    sweep_places: int = 3  # on each side of the cube around a start
    swept_closer: int = 24
    swept_pixels: int = 300_000
    # What a round proposes.
    num_candidates: int = 32
    pool: int = 2500  # poses that candidates are chosen from
    distinct: PoseDistance = PoseDistance(0.6, 18.0)
    # So many are looked at first, with some that are far from the best of them.
    first_portion: int = 6
    first_elsewhere: int = 3
    elsewhere: PoseDistance = PoseDistance(1.5, 30.0)
    # Near the best pose: how far, and how many are proposed there.
    near_m: float = 0.7
    near_deg: float = 20.0
    near_candidates: int = 24
    near_distinct: PoseDistance = PoseDistance(0.4, 12.0)
    # Without a hint of the place, no refined pose lies farther than this beyond the free space that starts stand for, metres.
    reach_m: float = 0.75


@dataclass(frozen=True)
class FieldOfViewConfig:
    """How the field of view of a photo is found that nobody knows (see `panoloc.core.query.field_of_view`). Steps:
    factors of the focal length."""

    search_step: float = 1.14  # the search bears focal lengths that are 7 % off
    most_tried: int = 3  # of the fields of view that the search likes best, refined one after the other
    most_rounds: int = 6  # of refinement with the focal length, each with a window of the focal length found before
    settled: float = 1.004  # factor of the focal length below which rounds end
    # The share that a focal length which was found may be off by (68 %) is this over the root of the information that the photos have of
    # it, within these bounds.
    noise: float = 0.05
    least_uncertainty: float = 0.01
    most_uncertainty: float = 0.3


@dataclass(frozen=True)
class CameraCheckConfig:
    """When photos are held to contradict the focal length that they are said to have (see `panoloc.core.query.camera_check`).

    How strongly they do is the logarithm of the factor by which it is off, times the root of the information that they have of it.
    """

    suspect: float = 0.03  # by the first steps from the pose found: then it is refined with the focal length
    contradicting: float = 0.15  # then they are localized with the focal length that they want as well
    better: float = 1.05  # of the judge's score without: what that needs to be the answer
    least_log: float = 0.08  # of the factor; less may come from the noise of tracking, and does little harm
