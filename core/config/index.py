"""What a map index is built with: starts, and what is kept of the view from each."""

import hashlib
from dataclasses import asdict, dataclass

from panoloc.core.config.distances import DISTANCES
from panoloc.core.config.imaging import CONTRAST, RENDERING


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
