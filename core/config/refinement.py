"""Refinement, coarse to fine, and what is different in it for photos."""

from dataclasses import dataclass, replace

from panoloc.core.config.search import PoseDistance


@dataclass(frozen=True)
class StoppingRule:
    """When candidates stop before their last step; looked at after every `interval` steps.

    move_m, turn_rad: a candidate whose last step was shorter than both has converged. merge: of candidates nearer to each other the one
    with the smallest loss goes on alone.
    """

    move_m: float
    turn_rad: float
    merge: PoseDistance | None = None
    interval: int = 4


@dataclass(frozen=True)
class StepConfig:
    """One step of Gauss-Newton (see `panoloc.core.refine.gauss_newton`)."""

    fit_light: bool = True  # gain and offset per channel; labels have no light
    robust_scale: float = 2.5  # of the median residual; 1.0 and 1.5 lose poses, at full resolution millimetres
    min_residual: float = 0.02  # floor of the robust scale, canonical colours
    min_residual_labels: float = 0.5  # labels agree exactly but at edges, and edges are all there is to align
    median_points: int = 512  # whose median residual is within some percent of that of all
    max_turn_rad: float = 0.2
    max_move_m: float = 0.3
    damping: float = 1e-3  # of the diagonal; 1e-4 and 1e-2 are worse
    # Of points that are aligned patch by patch (see `panoloc.core.refine.patch_step`).
    min_patch_variance: float = 1e-3  # of aligned colours; below it contrast is noise
    patch_robust_scale: float | None = None  # of the median residual, as robust_scale; None: points keep their vote
    min_patch_ratio: float = 1e-4  # floor of that median, squared and over the variance of a patch
    relaxation: float = 1.5  # the first step is this much longer, later ones by what the last one fell short
    max_relaxation: float = 5.0

    def for_labels(self) -> "StepConfig":
        """Return the configuration of a step on label codes."""
        return replace(self, fit_light=False, min_residual=self.min_residual_labels)


@dataclass(frozen=True)
class HalvesConfig:
    """Whether halves of a picture, refined apart from the pose found, meet at one (see
    `panoloc.core.refine.halves`)."""

    square_deg: float = 11.25  # of the chessboard that parts them
    rows: int = 128  # of the level they are refined on: finer ones hold them where they are
    every: int = 2  # of the points; with a quarter of them halves of right poses end twice as far apart
    iterations: int = 6


@dataclass(frozen=True)
class RefinementConfig:
    """Refinement coarse to fine (see `panoloc.core.fast.fast_method`). Iterations: at most; heights: rows of an
    image."""

    start_view_height: int = 64  # rows of the views from starts
    coarse_points: int = 1024  # seen from the start, spread evenly over the sphere
    coarse_iterations: tuple[int, int] = (16, 12)  # at half the rows of a view, and at all of them
    # Of local contrast in the colours that are aligned: half where poses may lie far off in another light, less where
    # millimetres count.
    contrast_share: float = 0.5
    fine_contrast_share: float = 0.3
    # Of the steps from the starts; None: as of all steps.
    rough_damping: float | None = None
    rough_max_relaxation: float | None = None
    coarse_stop: StoppingRule = StoppingRule(0.01, 0.01, PoseDistance(0.1, 2.865))
    middle_candidates: int = 8
    middle_margin: float = 0.35  # of the judge's score; candidates further behind the best never won
    middle_points: int = 4096
    middle_iterations: int = 6  # in each of the rounds below
    middle_stop: StoppingRule = StoppingRule(0.002, 0.002, interval=3)
    # Rows, and robust scale: changed furniture loses its vote as poses settle.
    middle_rounds: tuple[tuple[int, float], ...] = ((64, 2.5), (128, 1.5))
    unchanged_difference: float = 0.3  # canonical colour distance at which a pixel counts half as unchanged
    unchanged_regions: int = 32  # that the height of a view is divided into, to tell what changed
    fine_stop: StoppingRule = StoppingRule(0.0003, 0.0003, interval=2)
    fine_candidates: int = 2
    fine_margin: float = 0.25  # of the judge's score; candidates further behind the best never won
    visibility_height: int = 256  # of the rendering that finds the points seen at full resolution
    fine_height: int = 256
    fine_points: int = 12_000
    fine_iterations: int = 6
    finest_height: int = 512
    finest_points: int = 24_000
    finest_iterations: int = 4
    halves: HalvesConfig = HalvesConfig()


@dataclass(frozen=True)
class PhotoRefinementConfig:
    """What is different in the refinement of photos (see `panoloc.core.refine.photo_points`)."""

    coarse_points: int = 400  # that the photos show
    # Where points are aligned by patches they are so many only for photos that show this share of the sphere or less, as one of 69
    # degrees does, and more for others: a patch has a gain and offsets of its own, and a dozen points agree with anything.
    coarse_points_share: float = 0.085
    coarse_margin_deg: float = 35.0  # around what they show, likewise dense
    wide_coarse_margin_deg: float = 20.0  # likewise, of photos that show much, which turn less
    margin_deg: float = 8.0  # later, when poses hardly turn
    # Of local contrast in the colours: what a photo shows of the light of a room says little about all of it.
    contrast_share: float = 0.8
    fine_contrast_share: float = 0.2  # less: patches have a light of their own
    # Of photos of labels, which are aligned point by point. Changed furniture can be most of a photo, and drags poses away: it loses its
    # vote sooner, and first steps are shorter. The scale is also that of the curvature that radii are worked out from, of all photos.
    robust_scale: float = 1.5
    damping: float = 0.1
    max_relaxation: float = 1.5
    middle_candidates: int = 12
    # Of the judge's score, which is far smaller than that of panoramas: later winners were up to 0.13 behind the best.
    middle_margin: float = 0.15
    fine_margin: float = 0.15
    middle_points: int = 2048
    # Photos in colours are aligned patch by patch (see `panoloc.core.refine.patch_step`): degrees that a patch is high
    # and wide on what starts see, at full resolution, and in rounds between them, with their rows and robust scale.
    # Where poses are nearly right points keep their vote: they come half as near without it.
    rough_patch_deg: float = 22.5
    fine_patch_deg: float = 11.25
    patch_rounds: tuple[tuple[int, float, float | None], ...] = ((64, 22.5, 2.0), (64, 22.5, 2.0), (128, 11.25, None))
    # Of local contrast in the colours of the rounds: patches have a light of their own.
    patch_contrast_share: float = 0.4
    # Of candidates refined at half the rows of what starts see, so many go on: a share, but so many of the best at least.
    rough_kept_share: float = 0.5
    rough_kept: int = 10
    rough_patch_step: StepConfig = StepConfig(damping=0.1, relaxation=1.0, max_relaxation=1.5, patch_robust_scale=2.0)
    patch_step: StepConfig = StepConfig(
        damping=0.05, relaxation=1.3, max_relaxation=1.5, max_turn_rad=0.1, max_move_m=0.15
    )
    fine_points: int = 8000
    finest_points: int = 12_000
    # Of a pose together with a focal length: rows of the levels, and steps on each.
    focal_rows: tuple[int, ...] = (64, 128)
    focal_iterations: int = 12
    # Of a first look at the coarsest of these whether a known focal length fits: steps, and every so-manieth point.
    pull_iterations: int = 3
    pull_every: int = 2

    def coarse_points_of(self, share: float) -> int:
        """Return how many points are aligned by patches on what starts see, of photos that show a `share` of the sphere."""
        return round(max(1.0, share / self.coarse_points_share) * self.coarse_points)
