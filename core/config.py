"""Configuration: one frozen dataclass per step, each default in one place with its source."""

import hashlib
from dataclasses import asdict, dataclass, field


@dataclass(frozen=True)
class StartsConfig:
    """Where the search starts (see `core.index.starts`). Metres."""

    spacing_m: float = 0.5  # basin of convergence in a furnished room (measured)
    max_starts: int = 800
    clearance_m: float = 0.25  # nobody holds a camera closer to a surface
    thinning_share: float = 0.75  # of the spacing
    min_coverage_share: float = (
        0.6  # of what well-placed starts see; below it a start lies outside of the scanned space
    )


@dataclass(frozen=True)
class SearchConfig:
    """The search over all starts and rotations (see `core.describe.patch_descriptors`, `core.search.pose_scores`)."""

    patch_rows: int = 8  # paper, §4: 8 x 16 patches
    patch_columns: int = 16
    view_height: int = 64  # eight rows of pixels in a patch are enough for its histogram (measured)
    bins: int = 8  # per channel, joint
    descriptor_size: int = 32  # of 1,024 bins; more gain none (docs/experiments.md)
    num_rotations: int = 2304  # spacing about 18 degrees, within the basin of refinement
    # A first pass with pairs of rows and columns of patches taken together discards most starts (docs/experiments.md).
    coarse_rotations: int = 576
    coarse_kept_share: float = (
        1 / 3
    )  # of the starts; the right one was among the first 0.23 wherever the full search finds it
    coarse_kept_starts: int = 128  # never fewer
    num_candidates: int = 32
    distinct_angle_deg: float = 25.0  # candidates closer than both of these are one candidate
    distinct_distance_m: float = 0.8


@dataclass(frozen=True)
class Rest:
    """When candidates stop before their last step; looked at after every `interval` steps.

    move_m, turn_rad: a candidate whose last step was shorter than both rests. apart_m, apart_rad: of candidates nearer to each other
    than both, the one with the smallest loss goes on alone.
    """

    move_m: float
    turn_rad: float
    apart_m: float = 0.0
    apart_rad: float = 0.0
    interval: int = 4


@dataclass(frozen=True)
class RefinementConfig:
    """Refinement coarse to fine (see `core.refine.gauss_newton`, `core.fast_method`)."""

    coarse_points: int = 1024  # seen from the start, spread evenly over the sphere
    coarse_iterations: tuple[int, int] = (16, 12)  # at most, at 32 and 64 rows
    # Of local contrast in the colours that are aligned: half where poses may lie far off in another light, less where millimetres
    # count (docs/experiments.md).
    contrast_share: float = 0.5
    fine_contrast_share: float = 0.3
    coarse_rest: Rest = Rest(0.01, 0.01, 0.1, 0.05)
    robust_scale: float = 2.5  # of the median residual; 1.0 and 1.5 lose poses (docs/experiments.md)
    min_residual: float = 0.02  # floor of the robust scale, canonical colours
    min_residual_labels: float = 0.5  # labels agree exactly but at edges, and edges are all there is to align
    middle_candidates: int = 8
    middle_margin: float = (
        0.35  # of the judge's score; candidates further behind the best never won (docs/experiments.md)
    )
    middle_points: int = 4096
    middle_iterations: int = 6  # at most, in each of the rounds below
    middle_rest: Rest = Rest(0.002, 0.002, interval=3)
    # Rows of the image, and robust scale: changed furniture loses its vote as poses settle.
    middle_rounds: tuple[tuple[int, float], ...] = ((64, 2.5), (128, 1.5))
    fine_rest: Rest = Rest(0.0003, 0.0003, interval=2)
    fine_robust_scale: float = 2.5  # 1.5 loses millimetres (docs/experiments.md)
    fine_candidates: int = 2
    fine_margin: float = 0.25  # of the judge's score; candidates further behind the best never won
    visibility_height: int = 256  # rows of the rendering that finds the points seen at full resolution
    fine_height: int = 256
    fine_points: int = 12_000
    fine_iterations: int = 6
    finest_height: int = 512
    finest_points: int = 24_000
    finest_iterations: int = 4


@dataclass(frozen=True)
class JudgeConfig:
    """The comparison of the scan rendered at a refined pose with the panorama (see `core.judge.agreement`)."""

    height: int = 64
    final_height: int = 128


@dataclass(frozen=True)
class PaperConfig:
    """The paper's own parameters (§4 and supplement)."""

    num_starts: int = 100
    num_rotations: int = 216
    num_candidates: int = 6
    search_rows: int = 8
    search_columns: int = 16
    map_rows: int = 16
    map_columns: int = 32
    bins: int = 8
    view_height: int = 128
    iterations: int = 100
    learning_rate: float = 0.1  # of the reference implementation
    match_colors: bool = True
    initialize_by_histograms: bool = True
    use_score_map_2d: bool = True
    use_score_map_3d: bool = True


@dataclass(frozen=True)
class LocalizerConfig:
    """Everything that a query is answered with."""

    search: SearchConfig = field(default_factory=SearchConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    judge: JudgeConfig = field(default_factory=JudgeConfig)
    paper: PaperConfig = field(default_factory=PaperConfig)


@dataclass(frozen=True)
class IndexConfig:
    """Everything that a map index is built with."""

    starts: StartsConfig = field(default_factory=StartsConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    finest_spacing_m: float = 0.025  # points closer together move no pose (docs/experiments.md)
    finest_spacing_share: float = 1 / 300  # of the scan's diagonal, where that is less: models and toys
    render_batch: int = 8  # views rendered at once

    def digest(self) -> str:
        """Return 16 hex digits that change whenever an index built with this configuration would."""
        return hashlib.sha256(repr(sorted(asdict(self).items())).encode()).hexdigest()[:16]
