"""Configuration: one frozen dataclass per step, each default in one place with its unit and its source.

Where no other source is named, a figure was chosen by measurement on cases with known poses (docs/experiments.md).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class PoseDistance:
    """Two poses that are nearer to each other than both of these are one."""

    distance_m: float
    angle_deg: float


@dataclass(frozen=True)
class PoseDistances:
    """The distances that poses are told apart by, at every step of a query alike."""

    same: PoseDistance = PoseDistance(0.1, 3.0)  # what refinement brings so near to each other is one pose
    place: PoseDistance = PoseDistance(0.5, 15.0)  # beyond it poses are different candidates, and different answers
    right: PoseDistance = PoseDistance(0.3, 10.0)  # nearer to the true pose than that, a pose is right
    elsewhere: PoseDistance = PoseDistance(1.5, 30.0)  # beyond it what looks the same is no view from beside a place


DISTANCES = PoseDistances()


@dataclass(frozen=True)
class ContrastConfig:
    """Local contrast (see `panoloc.core.features.local_contrast`)."""

    darkest: float = 0.03  # colour, added before the logarithm: below it there is only noise
    rows: int = (
        16  # of the image in which surroundings are averaged; they are smooth, and four times as many rows tell them
    )
    concentration: float = 40.0  # of the weights around a direction: a standard deviation of 9 degrees
    scale: float = 0.5  # logarithm of the ratio at which contrast begins to saturate
    noise: float = 1e-3  # variance of colours in a patch below which contrast is noise

    @property
    def extent_rows(self) -> int:
        """Return the rows of the images that tell roughly what is shown."""
        return 2 * self.rows


@dataclass(frozen=True)
class RenderingConfig:
    """Synthetic views (see `panoloc.core.render.synthetic_view`)."""

    footprint: float = 1.5  # pixel size over point spacing at which a random sampling of a surface leaves few holes
    slack_spacings: float = 4.0  # depth range of one surface inside a pixel seen at a slant, in point spacings
    slack_share: float = 0.02  # likewise, of the depth
    fill_levels: int = 2  # holes up to 4 pixels are filled from their surroundings


CONTRAST, RENDERING = ContrastConfig(), RenderingConfig()


@dataclass(frozen=True)
class StartsConfig:
    """Where the search starts (see `panoloc.core.map.starts`)."""

    spacing_m: float = 0.5  # basin of convergence in a furnished room
    max_starts: int = 800
    clearance_m: float = 0.25  # nobody holds a camera closer to a surface
    stray_share: float = 0.002  # of the points, at each end of an axis, that do not count as extent
    max_cells: int = 20_000_000  # more do not fit into memory; a scan that large is no building, or its unit is wrong
    min_coverage_share: float = 0.6  # of what the best start sees; below it a start lies outside of the scanned space


@dataclass(frozen=True)
class DescriptorConfig:
    """How views and images are described (see `panoloc.core.features.described_views`), the same for an index and the queries to it."""

    view_height: int = 64  # rows of views from starts, and of coarse renderings
    bins: int = 8  # per channel, joint (paper, §4)
    size: int = 32  # numbers of a descriptor, of 1,024 bins; more gain none
    steps: int = 31  # up and down that a number of a descriptor is rounded to
    basis_views: int = 24  # that principal directions are taken from

    @property
    def patch_rows(self) -> int:
        """Return how many patches lie above each other: four rows of pixels are enough for a histogram.

        Patches of 11 degrees; the paper's 22 (§4) come of four together.
        """
        return self.view_height // 4

    @property
    def patch_deg(self) -> float:
        """Return how many degrees a patch is high, and wide at the horizon."""
        return 180 / self.patch_rows

    @property
    def picture_height(self) -> int:
        """Return the rows of the pictures that poses are scored again on."""
        return self.view_height // 2


@dataclass(frozen=True)
class AliasConfig:
    """Which starts look the same (see `panoloc.core.map.aliases`), by the scores of patches of 22 degrees."""

    least: float = 1.55  # score; the median of equal rooms is 2.7, of other rooms 1.2
    most: int = 3  # of each start


@dataclass(frozen=True)
class IndexConfig:
    """Everything that a map index is built with."""

    starts: StartsConfig = StartsConfig()
    descriptors: DescriptorConfig = DescriptorConfig()
    aliases: AliasConfig = AliasConfig()
    finest_spacing_m: float = 0.025  # points closer together move no pose
    finest_spacing_share: float = 1 / 300  # of the scan's diagonal, where that is less: models and toys

    def digest(self) -> str:
        """Return 16 hex digits that change whenever an index built with this configuration would."""
        settings = sorted(asdict(self).items())
        return hashlib.sha256(repr((settings, DISTANCES, CONTRAST, RENDERING)).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class JudgeConfig:
    """The scan rendered at a refined pose against the panorama, and which poses differ (see `panoloc.core.decide`)."""

    # Of the score, where lines agree with a rotation no more than with any (see `panoloc.core.features.line_support`); of ones in between,
    # less.
    lines_share: float = 0.3
    # One of several images contradicts the pose of the others where the scan explains less of it than this times its contrast above noise
    # (see `panoloc.core.decide.agreement`); and the share of images that may.
    least_explained: float = 0.2
    contradicting_share: float = 0.34
    # What the tracking of several images adds to the radii of position and orientation, in quadrature: so many times its noise. With it
    # 0.66 and 0.67 of 290 right sessions are within their radii, which were fitted on none of them.
    tracking_radii: tuple[float, float] = (1.5, 1.0)
    # Images whose edges are together shorter than this show a plain wall. Of 127 photos of rooms the barest had 131 degrees, of 16 walls in
    # soft light, with and without grain, the richest 46; 20 degrees of a photo had 75 and were put elsewhere.
    least_edges_deg: float = 90.0
    sure: float = 0.9  # from which on a place is the answer, and the search ends


@dataclass(frozen=True)
class ChangeConfig:
    """What has changed since the scan (see `panoloc.core.decide.change_maps`)."""

    most_gain: float = 3.0  # between the light of scan and photo, and at least one over it
    half_score_difference: float = 0.2  # of canonical colours; the score is 0.5 there
    sampled_points: int = 50_000  # of the scan, enough for a fraction


@dataclass(frozen=True)
class LineConfig:
    """Edges, and the lines that they are of (see `panoloc.core.features.line_support`)."""

    squares: int = 512  # that photos are divided into
    edges_in_square: int = 3  # the strongest
    edge_over_noise: float = 3.0  # how much faster than in half of the photo colours change there
    least_gradient: float = 0.5  # of the logarithm of colours, per radian: less than one step of eight bits
    edge_noise_deg: float = 1.5  # of the direction of an edge
    aligned_share: float = 0.6  # of the edges, that are along an axis
    support_rows: int = 90  # of the map of vanishing points
    # Lines are not asked where the best rotation is hardly better than rotations by chance (mean logarithm of the likelihood ratio of an
    # edge).
    least_contrast: float = 0.2


@dataclass(frozen=True)
class StoppingRule:
    """When candidates stop before their last step; looked at after every `interval` steps.

    A candidate has converged whose last step turned it by less than so many pixels of the level, and moved it by less than as many would
    be a metre away. Of candidates that have come to the same pose the one with the smallest loss goes on alone.
    """

    pixels: float = 0.15
    interval: int = 2


@dataclass(frozen=True)
class StepConfig:
    """One step of Gauss-Newton (see `panoloc.core.refine.step`)."""

    damping: float = 0.05  # of the diagonal
    lengthening: float = 1.3  # of every step but the last
    max_step_m: float = 0.15
    robust_scale: float | None = (
        None  # of the median residual, at which a point counts a quarter; None: points keep their vote
    )


@dataclass(frozen=True)
class MediumRound:
    """One of the rounds between coarse and fine: rows of the level, degrees that a patch is high and wide, and robust scale."""

    rows: int
    patch_deg: float
    robust_scale: float | None


@dataclass(frozen=True)
class RefinementConfig:
    """Refinement coarse to fine (see `panoloc.core.query.refinement`). Iterations: at most; rows: of a sphere."""

    # Coarse, on what starts see, at half the rows of a view and at all of them: points, of what a rig shows that covers `coarse_share` or
    # less, more of others; around what images show, likewise dense, a margin that poses may turn.
    coarse_points: int = 400
    coarse_share: float = 0.085
    most_coarse_points: int = 1600
    coarse_margin_deg: float = 35.0
    coarse_step: StepConfig = StepConfig(damping=0.1, max_step_m=0.3, robust_scale=2.0)
    # Of local contrast in the colours that are aligned: most where poses may lie far off in another light; half of it in medium rounds, and
    # a quarter where millimetres count.
    contrast: float = 0.8
    # Medium, on what poses themselves see, found anew in each round as what a pose sees changes with it. Changed furniture loses its vote;
    # where poses are nearly right points keep it: they come half as near without.
    margin_deg: float = 8.0
    # Of the best score: candidates further behind it never won, and where nothing else was looked at a pose is taken to be so far ahead.
    margin: float = 0.35
    medium_points: int = 2048
    medium_rounds: tuple[MediumRound, ...] = (
        MediumRound(64, 22.5, 2.0),
        MediumRound(64, 22.5, 2.0),
        MediumRound(128, 11.25, None),
    )
    # Fine, on images of so many rows and of twice as many; of rigs that cover little at twice these rows.
    fine_candidates: int = 2
    fine_rows: int = 256
    fine_points: int = 8000
    finest_points: int = 12_000  # at twice those rows
    # Of the rendering that finds the points seen at full resolution; half where points fall into less than this share of the pixels: in a
    # room of 3,000 points poses are off by centimetres and not answered without.
    least_filled: float = 0.1
    step: StepConfig = StepConfig()
    iterations: int = 6  # twice as many of the coarse levels
    stop: StoppingRule = StoppingRule()
    # Of the points, by which halves of a picture are refined apart: with a quarter those of right poses end twice as far apart.
    halves_every: int = 2

    @property
    def finest_rows(self) -> int:
        """Return the rows of the finest images of rigs that cover little."""
        return 4 * self.fine_rows

    def coarse_points_of(self, share: float) -> int:
        """Return how many points are aligned on what starts see, of a rig that covers a `share` of the sphere."""
        return min(self.most_coarse_points, round(max(1.0, share / self.coarse_share) * self.coarse_points))


@dataclass(frozen=True)
class SearchConfig:
    """Rounds of search (see `panoloc.core.query.rounds`). What a round looks at follows from the share of the sphere that a rig covers."""

    # With patches of 11 degrees, as far apart as these; a quarter of them with patches twice as large.
    rotations: int = 9216
    # Rigs that cover at least this share are described by patches of 22 degrees, which tell them apart at a fiftieth of the cost; a first
    # pass by patches twice as large again discards most starts.
    wide_share: float = 0.6
    kept_share: float = 1 / 3  # of the starts; the right one was among the first 0.23 wherever it is found
    # The poses that patches like best are scored again by pixels, all together so many.
    rescored_pixels: int = 300_000  # and those of each translation grid
    # Of the score by patches, added to that by pixels (docs/experiments.md); twice that with lines.
    histogram_weight: float = 0.04
    # People hold cameras level: poses tilted no more than this are searched first.
    level_tilt_deg: float = 18.0
    # Lines say how a camera is turned (see `panoloc.core.search.map_search`). So many rotations are searched first, those of
    # them that are so far apart; of their poses a pool is scored by patches, and the best again by pixels.
    likely_rotations: int = 200
    likely_apart_deg: float = 4.0
    # The best of these are scored once more at places around their starts (see `panoloc.core.search.position_sweep`), and the first of them
    # on finer pictures at places around those; all places together have so many pixels.
    sweep_places: int = 3  # on each side of the cube around a start
    # What a round proposes.
    num_candidates: int = 32  # of which a quarter is looked at first
    pool: int = 2500  # poses that candidates are chosen from
    # Of many maps those are searched that retrieval likes best (see `panoloc.core.many_maps`): first an eighth of the number of
    # candidates, and then the others where no answer is sure.
    most_maps: int = 64
    # Maps look alike where one scores so much of what another scores for a view of that. The other scan of an equal room scored 0.91 to 1
    # in 50 views. The best of 900 other maps scored 0.7 in the median of 90 views, and more than 0.9 in a tenth of them.
    alike_share: float = 0.9

    @property
    def line_rotations(self) -> int:
        """Return of how many rotations, 3.5 degrees apart, lines choose: a third as far apart as those that are searched without lines."""
        return 32 * self.rotations

    @property
    def first_maps(self) -> int:
        """Return how many of many maps are searched first."""
        return max(1, self.num_candidates // 8)

    def look_alikes(self, scores: Sequence[float], number: int) -> list[int]:
        """Return the numbers of other maps that look from somewhere as map `number` does from where a view of it was taken, best first: no
        more than are searched beside it. scores: of all maps for that view."""
        if not scores[number] > 0:  # a map without colours
            return []
        alike = [n for n, score in enumerate(scores) if n != number and score >= self.alike_share * scores[number]]
        return sorted(alike, key=lambda n: -scores[n])[: self.first_maps - 1]

    @property
    def narrow_share(self) -> float:
        """Return the share of the sphere below which rigs are looked at more closely."""
        return self.wide_share / 2

    def likely_rotations_of(self, share: float) -> int:
        """Return of how many rotations lines choose, for a rig that covers a `share` of the sphere. The more it covers, the more a pose
        costs, and the more edges tell rotations apart: an eighth is enough for all of it."""
        return round(self.likely_rotations * min(1.0, 1 / (8 * max(share, 1e-3))))

    def halvings(self, is_wide: bool) -> int:
        """Return how often patches are pooled, two by two a side, that a rig is described by."""
        return 1 if is_wide else 0

    def rotations_with(self, halvings: int) -> int:
        """Return how many rotations are searched with patches that were pooled so often."""
        return self.rotations >> 2 * halvings


@dataclass(frozen=True)
class FocalConfig:
    """Focal lengths that are not known for certain (see `panoloc.core.query.focal_lengths`). Steps and bounds: of the logarithm."""

    # Between those that poses are refined from; the search bears half of it. Likewise (rad) between extents of the sphere.
    step: float = 0.15
    # EXIF data do not mention zooms, of up to 2.2; and who guesses a field of view may be off by a third.
    bounds: tuple[float, float] = (-0.4, 0.8)
    stated: float = 0.95  # times the score of a pose for another focal length than the stated one
    # Power of the share of the sphere that an image shows, times which its score counts: where only bounds of its focal length are known,
    # and in the odds of others against a stated one.
    chance: float = 0.35
    power: float = 25.0  # of the ratio of their scores, that poses of two focal lengths are as probable as
    damping: float = 0.002  # more would hold pose and focal length in the valley that they share
    noise: float = 0.07  # of the logarithm, for images with unit information of it
    contradiction: float = 4.0  # times that uncertainty is no chance


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
    aliases: AliasConfig = AliasConfig()
    search: SearchConfig = SearchConfig()
    focal: FocalConfig = FocalConfig()
    refinement: RefinementConfig = RefinementConfig()
    judge: JudgeConfig = JudgeConfig()
    change: ChangeConfig = ChangeConfig()
    lines: LineConfig = LineConfig()
    paper: PaperConfig = PaperConfig()
