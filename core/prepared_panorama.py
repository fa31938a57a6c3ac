"""A panorama, prepared: its levels and descriptors, made once for all maps that share its colours."""

import torch
from torch import Tensor

from panoloc.core.camera.panorama import Panorama
from panoloc.core.config import DescriptorConfig
from panoloc.core.features.equalization import LabelCodes
from panoloc.core.features.local_contrast import mixed_with_contrast
from panoloc.core.geometry.projection import wrap_border
from panoloc.core.image.image_level import ImageLevel, prepare_level
from panoloc.core.image.pyramid import PanoramaLevel, PanoramaPyramid
from panoloc.core.render.comparison import Comparison, compare
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.search.map_search import DescribedPanorama, describe_panorama


class PreparedPanorama:
    """The panorama's levels and descriptors, each made once: for all maps of colours, or for one of labels."""

    def __init__(self, panorama: Panorama, max_height: int, labels: LabelCodes | None, device: torch.device) -> None:
        self.labels = labels
        self.share = 1.0  # of the sphere; what is masked counts as not compared, as it always has
        self.pyramid = PanoramaPyramid(panorama, max_height, labels, device)
        self._described: DescribedPanorama | None = None
        self._levels: dict[tuple[int, float, bool], ImageLevel] = {}

    def described(self, config: DescriptorConfig) -> DescribedPanorama:
        """Return the panorama's descriptors."""
        if self._described is None:
            self._described = describe_panorama(self.pyramid, self.labels, config)
        return self._described

    def canonical_level(self, height: int, contrast_share: float, blur: bool = False) -> ImageLevel:
        """Return a level equalized over the whole panorama and mixed with contrast, prepared for sampling; blurred for the widest basin."""
        key = (height, contrast_share, blur)
        if key not in self._levels:
            level = self.pyramid.level(height)
            color = level.canonical(self.labels)
            if self.labels is None:
                color = _with_contrast(color, level, contrast_share)
            self._levels[key] = prepare_level(_blur(color, level.valid) if blur else color, level.valid)
        return self._levels[key]

    def compare(
        self, cloud: RenderCloud, rotations: Tensor, positions: Tensor, height: int, with_points: bool
    ) -> Comparison:
        """Render the cloud at poses, in `height` rows, beside the panorama."""
        level = self.pyramid.level(height)
        return compare(cloud, level, rotations, positions, height, self.labels is not None, with_points)

    def level_for(self, comparison: Comparison, height: int, contrast_share: float) -> ImageLevel:
        """Return a level with the colours of the one pose compared: its own equalization mixed with contrast, or label codes."""
        level = self.pyramid.level(height)
        if comparison.tables is None:
            return prepare_level(level.color, level.valid)
        recolored = level.recolored(comparison.tables[0])
        return prepare_level(_with_contrast(recolored, level, contrast_share), level.valid)


def _with_contrast(equalized: Tensor, level: PanoramaLevel, share: float) -> Tensor:
    """Mix equalized colours (3, H, W) of a level with its local contrast."""
    as_views = equalized.permute(1, 2, 0)[None], level.color.permute(1, 2, 0)[None], level.valid[None]
    return mixed_with_contrast(*as_views, share)[0].permute(2, 0, 1)


def _blur(color: Tensor, valid: Tensor) -> Tensor:
    """Smooth (3, H, W) over valid pixels (H, W) with the kernel 1 2 1 along both axes, around the seam and over the poles."""
    padded = wrap_border(torch.cat((color * valid, valid[None])))
    rows = padded[:, :-2] + 2 * padded[:, 1:-1] + padded[:, 2:]
    total = rows[..., :-2] + 2 * rows[..., 1:-1] + rows[..., 2:]
    return total[:3] / total[3:].clamp_min(1.0)
