"""The scan rendered at poses of a rig beside what its photos show there.

A rendered pixel is a point at a known depth, so it is looked up where each photo, from a centre of its own, would show it: parallax is
undone by the scan itself. Views are drawn in axes that go with the rig, and of the part of the sphere alone that the photos show: a photo
of 69 degrees shows a fourteenth of it.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from panoloc.core.features.equalization import equalize_where
from panoloc.core.geometry.sphere_window import window_around
from panoloc.core.image.photo_atlas import PhotoAtlas
from panoloc.core.image.photo_level import PhotoLevel, PhotoWindows
from panoloc.core.render.comparison import Comparison
from panoloc.core.render.drawn_points import ViewParts
from panoloc.core.render.render_cloud import RenderCloud
from panoloc.core.render.synthetic_view import SyntheticViews, render_parts

_NEAR_M = 1.0  # what a photo shows is hardly nearer; parallax widens what must be drawn by no more


class RigView:
    """The part of the sphere around a rig that its photos show, or almost: within `margin_deg`.

    rig_from_view: (3, 3), axes in which that part lies in the middle of the image.
    """

    def __init__(self, atlas: PhotoAtlas, margin_deg: float) -> None:
        self.atlas = atlas
        parallax = torch.asin((atlas.centers.norm(dim=-1) / _NEAR_M).clamp(max=1.0))
        self._half_angles = (atlas.cones + parallax).clamp(max=math.pi)
        x, y, z = atlas.shown_directions().unbind(-1)
        margin = math.radians(margin_deg) + float(parallax.max())
        turn, self._window = window_around(torch.atan2(y, x), torch.asin(z.clamp(-1, 1)), margin)
        around = torch.tensor(
            [[math.cos(turn), -math.sin(turn), 0.0], [math.sin(turn), math.cos(turn), 0.0], [0, 0, 1]]
        )
        self.rig_from_view = around.to(atlas.rotations)
        self._same: dict[int, _SameForAllPoses] = {}

    def parts(self, rotations: Tensor, height: int) -> ViewParts:
        """Return what is drawn of the views from K poses of the rig, rotations (K, 3, 3), at `height` rows to the sphere."""
        axes = torch.einsum("kab,mb->kma", rotations, self.atlas.rotations[:, :, 0])
        return ViewParts(rotations @ self.rig_from_view, self._window.at(height), axes, self._half_angles)

    def compare(
        self,
        cloud: RenderCloud,
        rotations: Tensor,
        positions: Tensor,
        height: int,
        is_labels: bool,
        with_points: bool = True,
    ) -> Comparison:
        """Render the cloud at K poses of the rig, rotations (K, 3, 3) and positions (K, 3), and look up what the photos show.

        Where several photos show a pixel, it is compared with the one whose middle is nearest. Equalized over what both sides see.
        """
        parts = self.parts(rotations, height)
        views = render_parts(cloud, positions, parts, with_points)
        seen, photo = self._look_up(views, height)
        weights = views.valid.flatten(1) * parts.window.solid_angles(positions.device) * (photo >= 0)
        scan, tables = views.color.flatten(1, 2), None
        if not is_labels:
            scan, _ = equalize_where(scan, weights, views.valid.flatten(1))
            seen, tables = equalize_where(seen, weights, photo >= 0)
        return Comparison(scan, seen, weights, tables, views, photo)

    def _look_up(self, views: SyntheticViews, height: int) -> tuple[Tensor, Tensor]:
        """Return the colours (K, S, 3) that photos show at the rendered pixels, and the number of the photo (K, S), −1 for none."""
        same = self._same_for_all_poses(height)
        valid, depth = views.valid.flatten(1), views.depth.flatten(1)
        count, size = depth.shape
        if same.alone is not None:
            color, shown = same.alone
            shown = shown & valid
            return color * shown[..., None], torch.where(shown, 0, -1)
        color = torch.zeros((3, count, size), device=depth.device)
        photo = torch.full((count, size), -1, dtype=torch.int64, device=depth.device)
        central = torch.full((count, size), -2.0, device=depth.device)
        depth = torch.where(valid, depth, 1.0)
        for number, near in enumerate(same.near):
            in_rig = same.directions.T[:, None, near] * depth[:, near]
            sampled, ahead = self._sampled(same.level, in_rig, number)
            before = central[:, near]
            better = valid[:, near] & (sampled[3] > 0.99) & (ahead > before)
            central[:, near] = torch.where(better, ahead, before)
            photo[:, near] = torch.where(better, number, photo[:, near])
            color[:, :, near] = torch.where(better, sampled[:3], color[:, :, near])
        return color.permute(1, 2, 0).contiguous(), photo

    def _sampled(self, level: PhotoLevel, in_rig: Tensor, number: int) -> tuple[Tensor, Tensor]:
        """Return what a photo shows at points of the rig (3, K, N): colour and validity (4, K, N), and how near they are to its middle."""
        atlas = self.atlas
        moved = in_rig - atlas.centers[number][:, None, None]
        x, y, z = (atlas.rotations[number].T @ moved.flatten(1)).view(in_rig.shape).unbind(0)
        flat = torch.hypot(x, y)
        sampled = level.sample(torch.atan2(y, x), torch.atan2(z, flat), number)
        return sampled.transpose(0, 1), x / torch.hypot(flat, z).clamp_min(1e-6)

    def _same_for_all_poses(self, height: int) -> "_SameForAllPoses":
        """Return what is the same for all poses at one resolution."""
        if height not in self._same:
            window = self._window.at(height)
            directions = window.directions(self.atlas.rotations.device) @ self.rig_from_view.T
            level = _colors_alone(self.atlas.windows(height))
            axes, cosines = self.atlas.rotations[:, :, 0], self._half_angles.cos()
            near = [(directions @ axis >= cosine).nonzero()[:, 0] for axis, cosine in zip(axes, cosines, strict=True)]
            alone = None
            if len(self.atlas) == 1:  # without parallax every pixel shows the same of the photo, whatever its depth
                sampled, _ = self._sampled(level, directions.T[:, None], 0)
                alone = sampled[:3, 0].T.contiguous(), sampled[3, 0] > 0.99
            self._same[height] = _SameForAllPoses(directions, near, level, alone)
        return self._same[height]


@dataclass(frozen=True)
class _SameForAllPoses:
    """directions: (S, 3), of the window's pixels in the axes of the rig. near: of each photo the numbers of the pixels that it might show.
    level: what photos show. alone: of an only photo colours (S, 3) and validity (S,) of the pixels."""

    directions: Tensor
    near: list[Tensor]
    level: PhotoLevel
    alone: tuple[Tensor, Tensor] | None


def _colors_alone(windows: PhotoWindows) -> PhotoLevel:
    """Return the windows as a level without derivatives: colour and validity."""
    planes = torch.cat((windows.color, windows.valid[None]))
    places = windows.tops, windows.first_rows, windows.first_columns, windows.heights, windows.widths
    return PhotoLevel(planes, windows.rows, *places)
