"""The search over starts and rotations."""

from dataclasses import dataclass


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
    # Lines say how a camera is turned (see `panoloc.core.search.line_evidence`). So many rotations are searched first, those of
    # them that are so far apart; of their poses a pool is scored by patches, and the best again by pixels.
    likely_rotations: int = 200
    likely_apart_deg: float = 4.0
    # The best of these are scored once more at places around their starts (see `panoloc.core.search.position_sweep`), and the first of them
    # on finer pictures at places around those; all places together have so many pixels.
    sweep_places: int = 3  # on each side of the cube around a start
    # What a round proposes.
    num_candidates: int = 32  # of which a quarter is looked at first
    pool: int = 2500  # poses that candidates are chosen from
    # Of many maps those are searched that retrieval likes best (see `panoloc.core.many_maps`): first a quarter of the number of
    # candidates, and then the others where no answer is sure; by rigs that show little all at once.
    most_maps: int = 64

    @property
    def line_rotations(self) -> int:
        """Return of how many rotations, 3.5 degrees apart, lines choose: a third as far apart as those that are searched without lines."""
        return 32 * self.rotations

    @property
    def narrow_share(self) -> float:
        """Return the share of the sphere below which rigs are looked at more closely."""
        return self.wide_share / 2

    def halvings(self, is_wide: bool) -> int:
        """Return how often patches are pooled, two by two a side, that a rig is described by."""
        return 1 if is_wide else 0

    def rotations_with(self, halvings: int) -> int:
        """Return how many rotations are searched with patches that were pooled so often."""
        return self.rotations >> 2 * halvings


@dataclass(frozen=True)
class FocalConfig:
    """Focal lengths that are not known for certain (see `panoloc.core.query.focal_lengths`). Steps and bounds: of the logarithm."""

    step: float = 0.15  # between those that poses are refined from; the search bears half of it
    # EXIF data do not mention zooms, of up to 2.2; and who guesses a field of view may be off by a third.
    bounds: tuple[float, float] = (-0.4, 0.8)
    stated: float = 0.95  # times the score of a pose for another focal length than the stated one
    # Power of the share of the sphere that an image shows, times which its score counts where only bounds of its focal length are known.
    chance: float = 0.35
    power: float = 25.0  # of the ratio of their scores, that poses of two focal lengths are as probable as
    damping: float = 0.002  # more would hold pose and focal length in the valley that they share
    noise: float = 0.05  # of the logarithm, for images with unit information of it
