"""The search over starts and rotations, for panoramas and for photos."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PoseDistance:
    """Two poses that are nearer to each other than both of these are one."""

    distance_m: float
    angle_deg: float


@dataclass(frozen=True)
class SearchConfig:
    """The search over all starts and rotations (see `panoloc.core.search`)."""

    num_rotations: int = 2304  # spacing about 18 degrees, within the basin of refinement
    # A first pass with pairs of rows and columns of patches taken together discards most starts.
    coarse_rotations: int = 576
    coarse_kept_share: float = 1 / 3  # of the starts; the right one was among the first 0.23 wherever it is found
    coarse_kept_starts: int = 128  # never fewer
    num_candidates: int = 32
    distinct: PoseDistance = PoseDistance(0.8, 25.0)
    # Poses looked at for each candidate; the second number only where too few of the first differ.
    pools: tuple[int, ...] = (16, 100)
    min_pool: int = 256
    # So many candidates are looked at first, alone, and some that are far from the best of them; None: all together.
    first_portion: int | None = None
    first_elsewhere: int = 3
    elsewhere: PoseDistance = PoseDistance(1.5, 30.0)
    # Hints cut off no start or rotation nearer to their limits than half the spacing of either.
    hint_margin_m: float = 0.5
    hint_margin_deg: float = 12.0
    # Without a hint of the place, no refined pose lies farther than this beyond the free space that starts stand for, metres.
    reach_m: float = 0.75


@dataclass(frozen=True)
class PhotoSearchConfig:
    """The search for photos, over all starts and more rotations (see `panoloc.core.search.photo_search`)."""

    num_rotations: int = 9216  # spacing about 11 degrees
    # People hold cameras level: poses tilted no more than this are searched first, and densely. An answer that is this sure is the answer;
    # one at a single place may be less so once all candidates of that search were looked at.
    level_tilt_deg: float = 18.0
    level_candidates: int = 32
    sure: float = 0.8
    sure_at_end: float = 0.7
    limited_rotations: int = 36_864  # spacing about 7 degrees, where hints, gravity or level cameras leave few of them
    limited_rescored_poses: int = 2500  # of these
    # Lines of photos say how a camera is turned (see `panoloc.core.search.line_evidence`). Of so many rotations, 3.5
    # degrees apart, this share is searched first, the best of it so far apart; of their poses so many are scored by
    # pixels.
    line_rotations: int = 294_912
    line_margin_deg: float = 2.0
    likely_share: float = 0.02
    fewest_likely: int = 64
    most_likely: int = 600
    likely_apart_deg: float = 4.0
    likely_described_poses: int = 5000
    likely_histogram_weight: float = 0.08
    likely_rescored_poses: int = 1000
    likely_rescored_pixels: int = 250_000
    # The best of these are scored once more at places around their starts (see `panoloc.core.search.position_sweep`),
    # the best of which are so far apart; and the first of them on finer pictures at places around those. Of all places
    # together so many pixels, fewer poses of many.
    swept: int = 80
    fewest_swept: int = 8
    swept_distinct: PoseDistance = PoseDistance(0.4, 10.0)
    sweep_step_m: float = 0.17
    most_swept_a_side: int = 3
    swept_closer: int = 24
    fewest_swept_closer: int = 2
    closer_a_side: int = 3
    swept_pixels: int = 300_000
    most_rotations: int = 12_000  # of the denser set; above it the other one is taken
    limit_margin_m: float = 0.5  # starts are no nearer to what hints allow than half their spacing
    limit_margin_deg: float = 6.0  # half the spacing of the denser set, and what a start's distance turns
    rescored_poses: int = 20_000
    # Of all poses together: of many photos each pose has many, and fewer poses need them. The second of the denser set.
    rescored_pixels: int = 2_500_000
    limited_rescored_pixels: int = 600_000
    most_patches: int = 64  # that histograms are compared of; six frames show 160, and so many of them rank as well
    histogram_weight: float = 0.04  # of a pose's score by histograms, added to that by pixels (docs/experiments.md)
    patch_pixels: int = 4  # of a picture, on each side of the squares in which correlation is measured
    min_variance: float = 4e-3  # of equalized colours in a square; below it contrast is noise
    num_candidates: int = 48
    first_portion: int = 6  # of them: where an answer is sure, the right one is seldom further behind
    pool: int = 2500  # poses that candidates are chosen from
    distinct: PoseDistance = PoseDistance(0.6, 18.0)
    # Photos that show no more than this share of the sphere, and would be localized, but not beyond doubt, are searched once more near the
    # place found: what fits nearly as well there must not have been overlooked. However sure they are for want of a rival, there is
    # doubt where the scan explains less than the third of the photo's contrast. Poses that were turned back are looked at in any case.
    closer_share: float = 0.2
    beyond_doubt: float = 0.97
    doubtful_explained: float = 0.2
    closer_m: float = 0.7
    closer_deg: float = 20.0
    closer_poses: int = 800
    closer_candidates: int = 24
    closer_distinct: PoseDistance = PoseDistance(0.4, 12.0)
    # Where photos would be localized, the maps are searched for places where all of the scan looks as it does at the one found, at so many
    # turns about the vertical: with a score of at least so much of that of the starts beside it (equal rooms have 0.9 and more, the
    # rest of a building up to 0.7), or of so much by itself (2.0 and more, up to 1.8).
    same_view_turns: int = 24
    same_view_turned_deg: float = 60.0  # at the place found, less than this is the place itself
    same_view_share: float = 0.74
    same_view_least: float = 1.9
    same_view_starts: int = 64  # that look most like it by patches twice as large are looked at closely,
    same_view_kept_share: float = 0.25  # and this share of all at least
    same_views: int = 3  # the best of them, in each map
    # Only where there is one, also for what looks like it in the photos alone.
    lookalike_turns: int = 48
    lookalike_poses: int = 1000  # looked at pixel by pixel,
    lookalike_pixels: int = 200_000  # and fewer of many photos, so that all of them together have so many pixels
    lookalikes: int = 4  # that are refined on what their starts see
    lookalikes_settled: int = 2  # and of them on what they see themselves
    # Of the score of the best, in that search and after each refinement: places that look less like it are left at that.
    lookalike_least: float = 0.5


@dataclass(frozen=True)
class FieldOfViewConfig:
    """How the field of view of a photo is found that nobody knows (see `panoloc.core.fast.field_of_view`). Steps:
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
    """When photos are held to contradict the focal length that they are said to have (see
    `panoloc.core.fast.camera_check`).

    How strongly they do is the logarithm of the factor by which it is off, times the root of the information that they have of it.
    """

    suspect: float = 0.03  # by the first steps from the pose found: then it is refined with the focal length
    contradicting: float = 0.15  # then they are localized with the focal length that they want as well
    better: float = 1.05  # of the judge's score without: what that needs to be the answer
    least_log: float = 0.08  # of the factor; less may come from the noise of tracking, and does little harm
