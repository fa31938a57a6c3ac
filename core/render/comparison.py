"""The scan rendered at poses of a rig beside what its images show there: what judgement and refinement compare.

A rendered pixel is a point at a known depth, so it is looked up where each image, from a centre of its own, would show it: parallax is
undone by the scan itself. Views are drawn in axes that go with the rig, and of the part of the sphere alone that the images show: a photo
of 69 degrees shows a fourteenth of it.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from panoloc.core.features.equalization import apply_tables, equalization_tables, equalize
from panoloc.core.geometry.sphere_window import directions_of, solid_angles_of, window_around
from panoloc.core.image.level import VALID_SHARE, Level
from panoloc.core.image.photo_window import EXTENT_ROWS
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.kernels.library import call, has_kernels_for
from panoloc.core.render.render_cloud import RenderCloud, ViewParts
from panoloc.core.render.synthetic_view import SyntheticViews, render_views

_NEAR_M = 1.0  # what an image shows is hardly nearer; parallax widens what must be drawn by no more


@dataclass(frozen=True)
class Comparison:
    """The scan rendered at K poses beside a rig's images, over the S pixels of the window of `views`, in the axes there.

    scan, seen: (K, S, 3) canonical colours. weights: (K, S) solid angle, zero where either is missing. tables: (K, 3, 256) equalization of
    the images over those pixels, None for labels. views: what was rendered. image: (K, S) int64, which image of the rig a pixel is
    compared with, −1 for none.
    """

    scan: Tensor
    seen: Tensor
    weights: Tensor
    tables: Tensor | None
    views: SyntheticViews
    image: Tensor

    @cached_property
    def depth_m(self) -> float | None:
        """Return the median distance to what is compared at the first pose, metres; None where nothing is."""
        seen = self.views.depth.flatten(1)[0][self.weights[0] > 0]
        return float(seen.median()) if len(seen) else None


class RigView:
    """The part of the sphere around a rig that its images show, or almost: within `margin_deg`.

    rig_from_view: (3, 3), axes in which that part lies in the middle of the image.
    """

    def __init__(self, pyramid: RigPyramid, margin_deg: float) -> None:
        self.pyramid = pyramid
        parallax = torch.asin((pyramid.centers.norm(dim=-1) / _NEAR_M).clamp(max=1.0))
        self._half_angles = (pyramid.cones + parallax).clamp(max=math.pi)
        extent = pyramid.windows(EXTENT_ROWS)
        x, y, z = extent.rig_directions[extent.valid > 0].unbind(-1)
        margin = math.radians(margin_deg) + float(parallax.max())
        turn, self._window = window_around(torch.atan2(y, x), torch.asin(z.clamp(-1, 1)), margin)
        around = torch.tensor(
            [[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0, 0, 1]]
        )
        self.rig_from_view = around.to(pyramid.rotations)
        self._alone: dict[int, tuple[Tensor, Tensor]] = {}

    def compare(
        self,
        cloud: RenderCloud,
        rotations: Tensor,
        positions: Tensor,
        rows: int,
        with_points: bool = True,
        log_focals: Tensor | None = None,
    ) -> Comparison:
        """Render the cloud at K poses of the rig, rotations (K, 3, 3) and positions (K, 3), and look up what the images show.

        rows: of the sphere. Where several images show a pixel, it is compared with the one whose middle is nearest. Colours are equalized
        over the pixels that both sides see, so that what only one of them shows does not shift the colours of the rest.
        with_points: also find the point that each pixel shows.
        """
        axes = torch.einsum("kab,mb->kma", rotations, self.pyramid.rotations[:, :, 0])
        window = self._window.at(rows)
        parts = ViewParts(rotations @ self.rig_from_view, window, axes, self._half_angles)
        views = render_views(cloud, positions, parts, with_points)
        seen, image = self._look_up(views, rows, log_focals)
        weights = views.valid.flatten(1) * solid_angles_of(window, positions.device) * (image >= 0)
        scan, tables = views.color.flatten(1, 2), None
        if self.pyramid.labels is None:
            scan, tables = equalize(scan, weights), equalization_tables(seen, weights)
            seen = apply_tables(seen, tables)
        return Comparison(scan, seen, weights, tables, views, image)

    def _look_up(self, views: SyntheticViews, rows: int, log_focals: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the colours (K, S, 3) that images show at the rendered pixels, and the number of the image (K, S), −1 for none."""
        valid, depth = views.valid.flatten(1), views.depth.flatten(1)
        if len(self.pyramid) == 1 and log_focals is None:
            # Without parallax every pixel shows the same of the image, whatever its depth.
            if rows not in self._alone:
                self._alone[rows] = self._at_depths(torch.ones_like(depth[:1]), torch.ones_like(valid[:1]), rows, None)
            color, image = self._alone[rows]
            return color * valid[..., None], torch.where(valid, image, -1)
        return self._at_depths(depth, valid, rows, log_focals)

    def _at_depths(self, depth: Tensor, valid: Tensor, rows: int, log_focals: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return what `_look_up` returns, at depths (K, S), metres, of pixels that are valid (K, S)."""
        count, size = depth.shape
        level = self.pyramid.windows(rows).as_seen
        directions = directions_of(self._window.at(rows), depth.device) @ self.rig_from_view.T
        if has_kernels_for(depth):
            found, image = depth.new_empty((count, size, 3)), torch.empty((count, size), dtype=torch.int64)
            seen = level.pixels, level.pixels.shape[1], level.rows, level.places
            cameras = level.rotations, level.centers, len(level.centers)
            rendered = directions, size, depth, valid, count
            call("look_up", *seen, *cameras, *rendered, self._half_angles.cos(), log_focals, found, image)
            return found, image
        color = torch.zeros((3, count, size), device=depth.device)
        image = torch.full((count, size), -1, dtype=torch.int64, device=depth.device)
        central = torch.full((count, size), -2.0, device=depth.device)
        # Where holes were filled nothing is known of depth: an only image shows the same there whatever it is, several show nothing.
        depth = torch.where(depth.isfinite(), depth, 1.0 if len(self.pyramid) == 1 else math.nan)
        axes, cosines = self.pyramid.rotations[:, :, 0], self._half_angles.cos()
        for number, (axis, cosine) in enumerate(zip(axes, cosines, strict=True)):
            near = (directions @ axis >= cosine).nonzero()[:, 0]
            in_rig = directions.T[:, None, near] * depth[:, near]
            sampled, ahead = self._sampled(level, in_rig, number, log_focals)
            before = central[:, near]
            better = valid[:, near] & (sampled[3] > VALID_SHARE) & (ahead > before)
            central[:, near] = torch.where(better, ahead, before)
            image[:, near] = torch.where(better, number, image[:, near])
            color[:, :, near] = torch.where(better, sampled[:3], color[:, :, near])
        return color.permute(1, 2, 0).contiguous(), image

    def _sampled(self, level: Level, in_rig: Tensor, number: int, log_focals: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return what an image shows at points of the rig (3, K, N): colour and validity (4, K, N), and how near they are to its middle."""
        moved = in_rig - level.centers[number][:, None, None]
        x, y, z = (level.rotations[number].T @ moved.flatten(1)).view(in_rig.shape).unbind(0)
        if log_focals is not None:
            factors = log_focals.exp()[:, None]
            y, z = y * factors, z * factors
        flat = torch.hypot(x, y)
        sampled = level.sample(torch.atan2(y, x), torch.atan2(z, flat), number)
        return sampled.transpose(0, 1), x / torch.hypot(flat, z).clamp_min(1e-6)
