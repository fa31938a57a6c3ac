"""The map index: everything about a scan that a query needs, computed once at registration."""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panoloc.core.features.described_views import DescribedViews
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.map.aliases import Aliases
from panoloc.core.render.render_cloud import RenderCloud, make_render_cloud

INDEX_VERSION = 7  # of what an index holds and means; rises with every change, so that older ones are built again
_RENDERED_BYTES = 40  # of a point in `render_cloud`: colours as floats, and places in six densities


@dataclass(frozen=True)
class MapIndex:
    """An index of N points and T starts.

    positions: (N, 3) float32 metres relative to `origin_offset`. colors: (N, 3) uint8 as scanned.
    origin_offset: (3,) float64. spacing: metres between points.
    starts: (T, 3) float32 metres relative to `origin_offset`. leaf_sizes: (T,) float32 metres, edges of the octree's leaves.
    views: what is kept of the T synthetic views. sampled_shares: (T,) float32, share of the sphere in whose pixels of such a view a point
    falls. aliases: which of the starts look the same. wall_axes: (3, 3) axes_from_map, along the walls, and surface_thickness_m; see
    `panoloc.core.map.wall_axes`. labels: codes when the colours are semantic labels, else None. num_points_read: points in the scan file.
    """

    positions: Tensor
    colors: Tensor
    origin_offset: NDArray[np.float64]
    spacing: float
    starts: Tensor
    leaf_sizes: Tensor
    views: DescribedViews
    sampled_shares: Tensor
    aliases: Aliases
    wall_axes: Tensor
    surface_thickness_m: float
    labels: LabelCodes | None
    num_points_read: int

    @property
    def num_points(self) -> int:
        """Return N."""
        return len(self.positions)

    @property
    def num_starts(self) -> int:
        """Return T."""
        return len(self.starts)

    @property
    def num_bytes(self) -> int:
        """Return the memory of all arrays in bytes, those included that the first query adds."""
        parts = [*(getattr(self, f.name) for f in fields(self)), self.aliases.starts, self.aliases.turns]
        held = sum(part.numel() * part.element_size() for part in parts if isinstance(part, Tensor))
        return held + self.views.num_bytes + _RENDERED_BYTES * self.num_points

    @property
    def start_positions(self) -> NDArray[np.float64]:
        """Return the starts (T, 3) in the scan's own frame."""
        return self.starts.cpu().numpy().astype(np.float64) + self.origin_offset

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the smallest and largest coordinates, each (3,), in the scan's own frame."""
        lower, upper = self.positions.amin(0).cpu().numpy(), self.positions.amax(0).cpu().numpy()
        return lower.astype(np.float64) + self.origin_offset, upper.astype(np.float64) + self.origin_offset

    def canonical_cloud_colors(self) -> Tensor:
        """Return point colours (N, 3) float32 in 0..1: as scanned, or the codes of the labels."""
        if self.labels is None:
            return self.colors.float() / 255
        return self.labels.recode(self.colors)[0]

    @cached_property
    @torch.inference_mode(False)  # what one query makes must serve every other
    def render_cloud(self) -> RenderCloud:
        """Return the points with canonical colours (as scanned, or label codes), ready for rendering; made once."""
        return make_render_cloud(self.positions, self.canonical_cloud_colors(), self.spacing)

    def to(self, device: torch.device | str) -> "MapIndex":
        """Return the index with its arrays on `device`."""
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{name: part.to(device) for name, part in parts.items() if hasattr(part, "to")})
