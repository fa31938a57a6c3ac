"""Configuration: one frozen dataclass per step, each default in one place with its unit and its source.

Where no other source is named, a figure was chosen by measurement on cases with known poses (docs/experiments.md).
"""

import hashlib
from dataclasses import asdict, dataclass, replace


@dataclass(frozen=True)
class PoseDistance:
    """Two poses that are nearer to each other than both of these are one."""

    distance_m: float
    angle_deg: float


@dataclass(frozen=True)
class ContrastConfig:
    """Local contrast (see `core.light.local_contrast`)."""

    darkest: float = 0.03  # colour, added before the logarithm: below it there is only noise
    sampled_rows: int = 64  # of a large image these say as much of the surroundings as all of it
    rows: int = 16  # of the image in which surroundings are averaged; they are smooth
    concentration: float = 40.0  # of the weights around a direction: a standard deviation of 9 degrees
    scale: float = 0.5  # logarithm of the ratio at which contrast begins to saturate


@dataclass(frozen=True)
class LightFitConfig:
    """Gain and offset between scan and photo (see `core.light.light_fit`)."""

    min_gain: float = 0.3
    max_gain: float = 3.0
    prior: float = 1e-3  # variance of colours with which a gain of 1 counts


@dataclass(frozen=True)
class RenderingConfig:
    """Synthetic views (see `core.views.synthetic_view`)."""

    footprint: float = 1.5  # pixel size over point spacing at which a random sampling of a surface leaves few holes
    slack_spacings: float = 4.0  # depth range of one surface inside a pixel seen at a slant, in point spacings
    slack_share: float = 0.02  # likewise, of the depth
    fill_levels: int = 2  # holes up to 4 pixels are filled from their surroundings


# How images are made and compared, alike for scan and photo and in every step.
CONTRAST, LIGHT_FIT, RENDERING = ContrastConfig(), LightFitConfig(), RenderingConfig()


@dataclass(frozen=True)
class StartsConfig:
    """Where the search starts (see `core.index.starts`)."""

    spacing_m: float = 0.5  # basin of convergence in a furnished room
    max_starts: int = 800
    clearance_m: float = 0.25  # nobody holds a camera closer to a surface
    thinning_share: float = 0.75  # of the spacing
    stray_share: float = 0.002  # of the points, at each end of an axis, that do not count as extent
    max_cells: int = 20_000_000  # more do not fit into memory; a scan that large is no building, or its unit is wrong
    # Of what well-placed starts see; below it a start lies outside of the scanned space.
    min_coverage_share: float = 0.6
    well_placed_quantile: float = 0.9


@dataclass(frozen=True)
class DescriptorConfig:
    """How patches are described (see `core.describe`), the same for an index and the queries to it."""

    patch_rows: int = 8  # paper, §4: 8 x 16 patches
    patch_columns: int = 16
    view_height: int = 64  # eight rows of pixels in a patch are enough for its histogram
    bins: int = 8  # per channel, joint (paper, §4)
    size: int = 32  # of 1,024 bins; more gain none
    basis_views: int = 160  # that principal directions are taken from
    basis_patches: int = 20_000


@dataclass(frozen=True)
class FineViewConfig:
    """What a map keeps of its views for photos, which show few patches of 22 degrees (see `core.describe.fine_views`)."""

    patch_rows: int = 16
    patch_columns: int = 32
    size: int = 32  # numbers of a descriptor
    basis_views: int = 24  # that principal directions are taken from
    picture_height: int = 32  # rows of the pictures that poses are scored again on
    steps: int = 31  # up and down that a number of a descriptor is rounded to


@dataclass(frozen=True)
class PhotoSearchConfig:
    """The search for photos, over all starts and more rotations (see `core.search.photo_search`)."""

    num_rotations: int = 9216  # spacing about 11 degrees
    limited_rotations: int = 36_864  # spacing about 7 degrees, where hints or gravity leave few of them
    most_rotations: int = 12_000  # of the denser set; above it the other one is taken
    limit_margin_m: float = 0.5  # starts are no nearer to what hints allow than half their spacing
    limit_margin_deg: float = 6.0  # half the spacing of the denser set, and what a start's distance turns
    rescored_poses: int = 20_000
    rescored_pixels: int = (
        2_500_000  # of all poses together: of many photos each pose has many, and fewer poses need them
    )
    patch_pixels: int = 4  # of a picture, on each side of the squares in which correlation is measured
    min_variance: float = 4e-3  # of equalized colours in a square; below it contrast is noise
    num_candidates: int = 48
    pool: int = 2500  # poses that candidates are chosen from
    distinct: PoseDistance = PoseDistance(0.6, 18.0)


@dataclass(frozen=True)
class PhotoRefinementConfig:
    """What is different in the refinement of photos (see `core.refine.photo_points`)."""

    coarse_points: int = 400  # that the photos show
    coarse_margin_deg: float = 35.0  # around what they show, likewise dense
    margin_deg: float = 8.0  # later, when poses hardly turn
    # Of local contrast in the colours: what a photo shows of the light of a room says little about all of it.
    contrast_share: float = 0.8
    fine_contrast_share: float = 0.5
    # Changed furniture can be most of a photo, and drags poses away: it loses its vote sooner, and first steps are shorter.
    robust_scale: float = 1.5
    damping: float = 0.1
    max_relaxation: float = 1.5
    middle_candidates: int = 12
    middle_points: int = 2048
    fine_points: int = 8000
    finest_points: int = 12_000


@dataclass(frozen=True)
class SearchConfig:
    """The search over all starts and rotations (see `core.search`)."""

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
    # Hints cut off no start or rotation nearer to their limits than half the spacing of either.
    hint_margin_m: float = 0.5
    hint_margin_deg: float = 12.0


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
    """One step of Gauss-Newton (see `core.refine.gauss_newton`)."""

    fit_light: bool = True  # gain and offset per channel; labels have no light
    robust_scale: float = 2.5  # of the median residual; 1.0 and 1.5 lose poses, at full resolution millimetres
    min_residual: float = 0.02  # floor of the robust scale, canonical colours
    min_residual_labels: float = 0.5  # labels agree exactly but at edges, and edges are all there is to align
    median_points: int = 512  # whose median residual is within some percent of that of all
    max_turn_rad: float = 0.2
    max_move_m: float = 0.3
    damping: float = 1e-3  # of the diagonal; 1e-4 and 1e-2 are worse
    relaxation: float = 1.5  # the first step is this much longer, later ones by what the last one fell short
    max_relaxation: float = 5.0

    def for_labels(self) -> "StepConfig":
        """Return the configuration of a step on label codes."""
        return replace(self, fit_light=False, min_residual=self.min_residual_labels)


@dataclass(frozen=True)
class RefinementConfig:
    """Refinement coarse to fine (see `core.fast_method`). Iterations: at most; heights: rows of an image."""

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


@dataclass(frozen=True)
class JudgeConfig:
    """The scan rendered at a refined pose against the panorama, and which poses differ (see `core.judge`)."""

    first_height: int = 64  # rows of the rendering of all candidates
    height: int = 64  # and of those that are left then
    final_height: int = 128
    patch_rows: int = 8
    inlier_difference: float = 0.15  # canonical colour distance at which a pixel counts half
    brightness_bins: int = 16  # of the mutual information
    min_variance: float = 1e-4  # of canonical colours; below it contrast is noise
    min_patch_variance: float = 1e-3
    merged: PoseDistance = PoseDistance(0.1, 3.0)  # before judgement
    distinct: PoseDistance = PoseDistance(0.15, 4.0)  # after judgement
    place: PoseDistance = PoseDistance(0.5, 15.0)  # beyond it poses are different answers
    # Of several images: correlation below which one contradicts the pose of the others, and the share that may.
    contradiction: float = 0.2
    contradicting_share: float = 0.25
    ambiguous_margin: float = 0.08  # of the score, between two places that both fit well
    # Of the score, in the features of the confidence: beyond the first the runner-up says nothing more; the second stands
    # for a runner-up that is not there. The coefficients were fitted with both.
    max_margin: float = 0.5
    unknown_margin: float = 0.2


@dataclass(frozen=True)
class ChangeConfig:
    """What has changed since the scan (see `core.judge.change_maps`)."""

    half_score_difference: float = 0.2  # of canonical colours; the score is 0.5 there
    changed_below: float = 0.5  # score
    sampled_points: int = 50_000  # of the scan, enough for a fraction


@dataclass(frozen=True)
class PaperConfig:
    """The paper's own parameters (§4 and supplement), and those of the reference implementation."""

    num_starts: int = 100
    num_rotations: int = 216
    num_candidates: int = 6
    search_rows: int = 8
    search_columns: int = 16
    map_rows: int = 16
    map_columns: int = 32
    bins: int = 8
    view_height: int = 128
    image_height: int = 512
    iterations: int = 100
    learning_rate: float = 0.1  # radians and metres; of the reference implementation
    learning_rate_decay: float = 0.8  # of the reference implementation
    patience: int = 5  # iterations without a smaller loss before it decays; of the reference implementation
    match_colors: bool = True
    initialize_by_histograms: bool = True
    initial_loss_points: int = 2_000  # where poses are initialized by the sampling loss instead
    use_score_map_2d: bool = True
    use_score_map_3d: bool = True


@dataclass(frozen=True)
class LocalizerConfig:
    """Everything that a query is answered with."""

    descriptors: DescriptorConfig = DescriptorConfig()
    search: SearchConfig = SearchConfig()
    photo_search: PhotoSearchConfig = PhotoSearchConfig()
    photos: PhotoRefinementConfig = PhotoRefinementConfig()
    step: StepConfig = StepConfig()
    refinement: RefinementConfig = RefinementConfig()
    judge: JudgeConfig = JudgeConfig()
    change: ChangeConfig = ChangeConfig()
    paper: PaperConfig = PaperConfig()
    fine_views: FineViewConfig = FineViewConfig()

    def for_photos(self, share: float) -> "LocalizerConfig":
        """Return the configuration for photos that show a `share` of the sphere: the less they show, the closer they are looked at."""
        finer = 2 if share < _NARROW_SHARE else 1
        refinement, judge, photos = self.refinement, self.judge, self.photos
        return replace(
            self,
            search=replace(self.search, num_candidates=self.photo_search.num_candidates),
            step=replace(self.step, robust_scale=photos.robust_scale),
            refinement=replace(
                refinement,
                contrast_share=photos.contrast_share,
                fine_contrast_share=photos.fine_contrast_share,
                rough_damping=photos.damping,
                rough_max_relaxation=photos.max_relaxation,
                middle_candidates=photos.middle_candidates,
                middle_points=photos.middle_points,
                middle_rounds=tuple((rows, photos.robust_scale) for rows, _ in refinement.middle_rounds),
                visibility_height=finer * refinement.visibility_height,
                fine_height=finer * refinement.fine_height,
                finest_height=finer * refinement.finest_height,
                fine_points=photos.fine_points,
                finest_points=photos.finest_points,
            ),
            judge=replace(
                judge,
                height=finer * judge.height,
                final_height=finer * judge.final_height,
                patch_rows=finer * judge.patch_rows,
            ),
        )


_NARROW_SHARE = 0.3  # of the sphere


@dataclass(frozen=True)
class IndexConfig:
    """Everything that a map index is built with."""

    starts: StartsConfig = StartsConfig()
    descriptors: DescriptorConfig = DescriptorConfig()
    fine_views: FineViewConfig = FineViewConfig()
    finest_spacing_m: float = 0.025  # points closer together move no pose
    finest_spacing_share: float = 1 / 300  # of the scan's diagonal, where that is less: models and toys

    def digest(self) -> str:
        """Return 16 hex digits that change whenever an index built with this configuration would."""
        settings = sorted(asdict(self).items())
        return hashlib.sha256(repr((settings, CONTRAST, RENDERING)).encode()).hexdigest()[:16]
