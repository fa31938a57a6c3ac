"""A rig, prepared: its levels, descriptors, edges and directions, each made once for all maps that share its colours."""

import math
from collections.abc import Sequence
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.camera.rig import Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.features.canonical import CanonicalColors
from panoloc.core.features.line_support import Edges, LineSupport, edges_of_photos
from panoloc.core.image.label_codes import LabelCodes
from panoloc.core.image.photo_window import shown_share
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.options import MAX_SESSION_TILT_DEG
from panoloc.core.query.focal_lengths import focal_prior
from panoloc.core.refine.aligned_points import LookDirections, look_directions
from panoloc.core.render.comparison import RigView
from panoloc.core.search.described_rig import DescribedRig
from panoloc.core.search.pose_limits import PoseLimits


class PreparedRig:
    """A rig in the colours of some maps.

    is_wide: whether it covers so much of the sphere that patches of 22 degrees tell it apart. finer: how many times as closely it is looked
    at as a panorama is.
    """

    def __init__(self, rig: Rig, labels: LabelCodes | None, device: torch.device, config: LocalizerConfig) -> None:
        self.config, self._camera = config, rig.photos[0].camera
        share = shown_share(rig)
        self.is_wide = share >= config.search.wide_share
        self.finer = 2 if share < config.search.narrow_share else 1
        self.pyramid = RigPyramid(rig, 2 * self.finer * config.refinement.fine_rows, labels, device)
        self.share = self.pyramid.share
        self.colors = CanonicalColors(self.pyramid)
        self.view = RigView(self.pyramid, config.refinement.margin_deg)
        self.prior = focal_prior(rig, config.focal)
        self._up_known = rig.options.up_known
        self._look: dict[tuple[int, float, float], LookDirections] = {}

    @property
    def is_labels(self) -> bool:
        """Return whether colours are codes of labels."""
        return self.pyramid.labels is not None

    def log_focals(self, group: Sequence[Hypothesis]) -> Tensor | None:
        """Return the logarithms (K,) of the focal lengths of hypotheses over those given; None where all are as given."""
        if all(h.log_focal is None for h in group):
            return None
        return torch.tensor([h.log_focal or 0.0 for h in group], device=self.pyramid.rotations.device)

    def shares(self, group: Sequence[Hypothesis]) -> Tensor:
        """Return the shares (K,) of the sphere that the images show with the focal lengths of hypotheses, as far as views of them go."""
        own = self._camera.solid_angle()
        shares = [self.share * min(1.0, self._camera.solid_angle(math.exp(h.log_focal or 0.0)) / own) for h in group]
        return torch.tensor(shares, device=self.pyramid.rotations.device)

    def likelihoods(self, group: Sequence[Hypothesis]) -> Tensor:
        """Return by how much less (K,) the scores of hypotheses count whose focal lengths are others than stated, or longer than they need
        be: the less of the sphere an image shows, the more easily it fits by chance."""
        prior, focal = self.prior, self.config.focal
        if prior is None:
            less = [1.0] * len(group)
        elif prior.is_stated:
            less = [1.0 if h.log_focal is None else focal.stated for h in group]
        else:
            widest = self._camera.solid_angle(math.exp(prior.least))
            less = [(self._camera.solid_angle(math.exp(h.log_focal or 0.0)) / widest) ** focal.chance for h in group]
        return torch.tensor(less, device=self.pyramid.rotations.device)

    @property
    def rows(self) -> int:
        """Return the rows of the coarse renderings that poses are judged on."""
        return self.finer * self.config.descriptors.view_height

    @property
    def patch_deg(self) -> float:
        """Return how many degrees the patches are high and wide that poses are judged by: as many rows of any rendering."""
        return 2 * self.config.descriptors.patch_deg / self.finer

    @property
    def margin_deg(self) -> float:
        """Return how far around what the images show points are aligned while poses may turn."""
        return self.config.refinement.coarse_margin_deg * (1.0 if self.finer > 1 else 0.5)

    def limits_of_rig(self, limits: PoseLimits) -> PoseLimits:
        """Return the limits of the rig's pose where those given are of the first camera."""
        tilt = math.radians(MAX_SESSION_TILT_DEG) if self._up_known else None
        return limits.of_rig(self.pyramid.rotations[0], self.pyramid.centers[0], tilt)

    @cached_property
    def described(self) -> DescribedRig:
        """Return what the images look like to the search."""
        return DescribedRig(self.colors, self.config.descriptors)

    @cached_property
    def edges(self) -> Edges:
        """Return the edges of the images."""
        return edges_of_photos(self.pyramid, self.config.lines)

    @cached_property
    def lines(self) -> LineSupport:
        """Return what the edges of the images say of how the rig is turned."""
        return LineSupport(self.edges, self.config.lines)

    def look(self, count: int, margin_deg: float, patch_deg: float) -> LookDirections:
        """Return `count` directions that the images show and as many around; see `look_directions`."""
        key = count, margin_deg, patch_deg
        if key not in self._look:
            self._look[key] = look_directions(self.pyramid, count, margin_deg, patch_deg)
        return self._look[key]

    def numbers_of(self, values: list[int]) -> Tensor:
        """Return whole numbers on the device of the rig."""
        return torch.tensor(values, device=self.pyramid.rotations.device)
