"""What the operator should know of a map that became ready although it can hardly serve.

The readers of `panoloc.core.scan` note what they did to the file; here is what only the finished index shows.
"""

import math
from collections.abc import Iterator

import numpy as np

from panoloc.core.config import CONTRAST, RefinementConfig
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import Box, IndexOptions
from panoloc.core.scan.point_cloud import Diagnostic

# A furnished room of 12 m² scanned with fewer covers less than a sixth of what its best start could see, measured.
_FEW_POINTS = 1000
# Of all points. Of bare white rooms, scanned, only a hundredth are within the noise of the colour in the middle.
_SAME_COLOR_SHARE = 0.95


def map_diagnostics(index: MapIndex, options: IndexOptions, num_points_given: int) -> Iterator[Diagnostic]:
    """Yield what the operator should know about `index`, which was built with `options` from that many points."""
    if index.num_points < num_points_given:
        message = (
            f"{num_points_given:,} points became {index.num_points:,}: those closer together than about "
            f"{100 * index.spacing:.1f} cm were merged, because a denser scan makes no pose more exact."
        )
        yield Diagnostic("merged_points", "info", message)
    if index.num_points < _FEW_POINTS:
        message = (
            f"The map has only {index.num_points:,} points; expected at least {_FEW_POINTS:,}, and tens of thousands for good "
            "poses. Upload the whole scan, not thinned."
        )
        yield Diagnostic("few_points", "warning", message)
    colors = index.colors.cpu().numpy().astype(np.int16)
    middle = np.median(colors, axis=0)
    share = float(np.mean(np.abs(colors - middle).max(axis=1) <= 255 * math.sqrt(CONTRAST.noise)))
    if share >= _SAME_COLOR_SHARE and options.color_kind != "labels":
        color = ", ".join(f"{value:.0f}" for value in middle)
        message = (
            f"{share:.0%} of the points have nearly the same colour ({color}); photos are compared with the scan by colours, and there is "
            "little to compare. Was the whole scan coloured from its photos?"
        )
        yield Diagnostic("hardly_any_colors", "warning", message)
    seen = float(index.sampled_shares.max())
    # Rooms 0.96, streets 0.58, a wall alone 0.02, starts beside a room 0.003. With less a pose is not refined at full resolution, either.
    least = RefinementConfig().least_filled
    if seen < least:
        message = (
            f"From the best of the {index.num_starts:,} starts the scan covers {seen:.1%} of the view; at least "
            f"{least:.0%} is expected. Is the scan dense enough, does it surround the places where cameras stand, and "
            "do the starts lie within it?"
        )
        yield Diagnostic("starts_see_little", "warning", message)
    if options.region is not None:
        yield from _region_outside_scan(index, options.region)


def _region_outside_scan(index: MapIndex, region: Box) -> Iterator[Diagnostic]:
    lower, upper = index.bounds
    low, high = (np.asarray(corner, np.float64) for corner in region)
    if bool((low >= lower).all() and (high <= upper).all()):
        return
    starts = index.start_positions
    num_outside = int(((starts < lower) | (starts > upper)).any(axis=1).sum())
    bounds = f"{_text(lower)} to {_text(upper)}"
    if num_outside == 0:
        message = f"starts.region reaches beyond the scan ({bounds}, metres); all starts lie within it."
        yield Diagnostic("region_outside_scan", "info", message)
        return
    message = (
        f"{num_outside:,} of {len(starts):,} starts lie outside of the scan ({bounds}, metres), as starts.region asks. Is "
        "the region in metres, in the scan's own frame with z up?"
    )
    yield Diagnostic("region_outside_scan", "warning", message)


def _text(corner: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in corner)})"
