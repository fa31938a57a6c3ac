"""Hints as limits on poses: which starts and rotations are searched, and which refined poses are allowed."""

import math
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from panoloc.core.config import DISTANCES
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_from_vector
from panoloc.core.map.map_index import MapIndex
from panoloc.core.options import DEFAULT_RADIUS_M, DEFAULT_TOLERANCE_DEG, QUATERNION_TOLERANCE, Hints

NOTICEABLE_TILT = math.radians(0.5)  # less is within what refinement is off by
_INSIDE = 1e-4  # radians; what is turned back to a limit must lie within it whatever is rounded


@dataclass(frozen=True)
class PoseLimits:
    """Limits in the index's local frame; a limit that is None does not apply. Angles in radians.

    Poses are those of a camera, or of a rig of several, whose first camera is then what hints speak of: first_rotation (3, 3) and
    first_center (3,), metres, are its pose in the rig. max_rig_tilt: of the rig's own up axis.
    """

    center: Tensor | None = None
    radius_m: float = math.inf
    lower: Tensor | None = None
    upper: Tensor | None = None
    max_tilt: float | None = None
    heading: float | None = None
    heading_tolerance: float = math.pi
    first_rotation: Tensor = field(default_factory=lambda: torch.eye(3))
    first_center: Tensor = field(default_factory=lambda: torch.zeros(3))
    max_rig_tilt: float | None = None

    def of_rig(self, first_rotation: Tensor, first_center: Tensor, max_rig_tilt: float | None) -> "PoseLimits":
        """Return the limits of a rig whose first camera these limits are of."""
        return replace(self, first_rotation=first_rotation, first_center=first_center, max_rig_tilt=max_rig_tilt)

    def leaves_tilts_beyond(self, tilt: float) -> bool:
        """Return whether cameras may tilt by more than `tilt`."""
        return self.max_rig_tilt is None and (self.max_tilt is None or self.max_tilt > tilt)

    def allows_position(self, positions: Tensor, margin_m: float = 0.0) -> Tensor:
        """Return which positions (..., 3) lie within the limits, widened by a margin."""
        allowed = torch.ones(positions.shape[:-1], dtype=torch.bool, device=positions.device)
        if self.center is not None:
            allowed &= (positions - self.center.to(positions)).norm(dim=-1) <= self.radius_m + margin_m
        if self.lower is not None and self.upper is not None:
            inside = (positions >= self.lower.to(positions) - margin_m) & (
                positions <= self.upper.to(positions) + margin_m
            )
            allowed &= inside.all(-1)
        return allowed

    def allows_rotation(self, rotations: Tensor, margin_rad: float = 0.0) -> Tensor:
        """Return which rotations (..., 3, 3) map_from_camera lie within the limits, widened by a margin.

        The heading is the azimuth of the image centre; with the camera pointing almost straight up or down it says nothing.
        """
        allowed = torch.ones(rotations.shape[:-2], dtype=torch.bool, device=rotations.device)
        # Rounding makes a level camera tilt, too.
        if self.max_rig_tilt is not None:
            allowed &= _tilt(rotations[..., 2]) <= self.max_rig_tilt + margin_rad + _INSIDE
        if self.max_tilt is not None:
            allowed &= _tilt(rotations @ self.first_rotation[:, 2]) <= self.max_tilt + margin_rad + _INSIDE
        if self.heading is not None:
            x, y = (part.contiguous() for part in (rotations[..., :2, :] @ self.first_rotation[:, 0]).unbind(-1))
            difference = torch.atan2(y, x) - self.heading
            wrapped = torch.atan2(difference.sin(), difference.cos()).abs()
            allowed &= (wrapped <= self.heading_tolerance + margin_rad) | (torch.hypot(x, y) < 0.05)
        return allowed

    @property
    def bounds_tilts(self) -> bool:
        """Return whether rotations may have to be turned back."""
        return self.max_rig_tilt is not None or self.max_tilt is not None

    def nearest_rotations(self, rotations: Tensor) -> Tensor:
        """Return rotations (K, 3, 3) turned back, by no more than it takes, to where they tilt as much as the limits allow.

        Refinement knows nothing of gravity: where a scene says little, it tilts the camera.
        """
        if self.max_rig_tilt is not None:
            rotations = _tilted_at_most(rotations, rotations[..., :, 2], self.max_rig_tilt)
        if self.max_tilt is not None:
            rotations = _tilted_at_most(rotations, rotations @ self.first_rotation[:, 2], self.max_tilt)
        return rotations

    def excess_tilt(self, rotation: Tensor) -> float:
        """Return by how many radians a rotation (3, 3) tilts more than the limits allow; 0 where they allow it."""
        excess = [0.0]
        if self.max_rig_tilt is not None:
            excess.append(float(_tilt(rotation[:, 2])) - self.max_rig_tilt)
        if self.max_tilt is not None:
            excess.append(float(_tilt(rotation @ self.first_rotation[:, 2])) - self.max_tilt)
        return max(excess)

    def allows_pose(self, rotation: Tensor, position: Tensor) -> bool:
        """Return whether a pose, (3, 3) map_from_camera and (3,), lies within the limits."""
        of_first = position + rotation @ self.first_center
        return bool(self.allows_position(of_first)) and bool(self.allows_rotation(rotation))

    def searched_starts(self, index: MapIndex) -> Tensor:
        """Return which starts (T,) of a map are searched: those whose leaves, the largest of which any may stand for, the limits reach with
        the first camera, wherever on the rig it is."""
        return self.allows_position(index.starts, float(index.leaf_sizes.max()) + float(self.first_center.norm()))


def _tilt(up: Tensor) -> Tensor:
    """Return the angles (...) of vectors (..., 3) from the map's z axis. By their cosine the least angles are lost in rounding."""
    x, y, z = (part.contiguous() for part in up.unbind(-1))  # on strided views arc tangents take fifteen times as long
    return torch.atan2(torch.hypot(x, y), z)


def _tilted_at_most(rotations: Tensor, up: Tensor, most: float) -> Tensor:
    """Return rotations (K, 3, 3) turned so that `up` (K, 3), unit vectors in the map, are at most `most` radians off its z axis."""
    flat = up[:, :2].norm(dim=-1)
    excess = (_tilt(up) - most + min(_INSIDE, most)).clamp_min(0.0)
    # The horizontal axis that turns `up` towards z; any, where it points straight down.
    axis = torch.stack((up[:, 1], -up[:, 0], torch.zeros_like(flat)), dim=-1) / flat.clamp_min(1e-9)[:, None]
    return rotation_from_vector(axis * excess[:, None]) @ rotations


def pose_limits(hints: Hints | None, index: MapIndex) -> PoseLimits:
    """Translate hints into the local frame of a map. Raises OptionsError for values out of range."""
    hints, offset = hints or Hints(), torch.from_numpy(index.origin_offset)

    def local(point: tuple[float, float, float]) -> Tensor:
        """Return a point of the scan's own frame, metres, as (3,) float32 relative to the map's origin."""
        # Subtracted before the cast: survey coordinates do not fit into float32.
        return (torch.tensor(point, dtype=torch.float64) - offset).float()

    _check(hints)
    position_m, radius_m, tilt = hints.position_m, hints.radius_m, hints.most_tilt_deg
    if position_m is None and hints.prior is not None and hints.prior.is_only:
        # Refined farther, a pose is a place elsewhere.
        x, y, z = Pose.from_frame(
            hints.prior.position_m, hints.prior.quaternion_xyzw, hints.prior.frame
        ).position.tolist()
        position_m, radius_m = (x, y, z), max(3 * hints.prior.position_std_m, DISTANCES.elsewhere.distance_m)
    tolerance = DEFAULT_TOLERANCE_DEG if hints.heading_tolerance_deg is None else hints.heading_tolerance_deg
    return PoseLimits(
        center=None if position_m is None else local(position_m),
        radius_m=radius_m if radius_m is not None else DEFAULT_RADIUS_M,
        lower=None if hints.region is None else local(hints.region[0]),
        upper=None if hints.region is None else local(hints.region[1]),
        max_tilt=None if tilt is None else math.radians(tilt),
        heading=None if hints.heading_deg is None else math.radians(hints.heading_deg),
        heading_tolerance=math.radians(tolerance),
    )


def within_reach(limits: PoseLimits, index: MapIndex) -> PoseLimits:
    """Return the limits, and where they say nothing of the place, hardly more than the free space of a map.

    Seen from above its ceiling a room is a plain picture, to which photos of plain things are refined.
    """
    if limits.center is not None or limits.lower is not None:
        return limits
    halves = index.leaf_sizes[:, None] / 2 + DISTANCES.place.distance_m
    return replace(limits, lower=(index.starts - halves).amin(0), upper=(index.starts + halves).amax(0))


def _check(hints: Hints) -> None:
    corners = hints.region or ()
    numbers = [*(hints.position_m or ()), *(value for corner in corners for value in corner)]
    if not all(math.isfinite(value) for value in (*numbers, hints.heading_deg or 0.0)):
        raise OptionsError(f"hints: expected finite numbers, got {hints}")
    prior = hints.prior
    if prior is not None:
        known = prior.position_std_m, prior.orientation_std_deg, *prior.position_m
        is_unit = abs(math.hypot(*prior.quaternion_xyzw) - 1) <= QUATERNION_TOLERANCE
        if not (is_unit and all(map(math.isfinite, known)) and min(known[:2]) > 0):
            raise OptionsError(
                f"hints.prior: expected finite numbers, a unit quaternion and positive standard deviations, got {prior}"
            )
    if hints.radius_m is not None and hints.position_m is None:
        raise OptionsError(
            "hints.radius_m: expected together with hints.position_m; give the position or leave out the radius"
        )
    if hints.radius_m is not None and not 0 < hints.radius_m < math.inf:
        raise OptionsError(f"hints.radius_m: expected a positive number of metres, got {hints.radius_m}")
    if hints.max_tilt_deg is not None and not 0 <= hints.max_tilt_deg <= 180:
        raise OptionsError(f"hints.max_tilt_deg: expected 0 to 180, got {hints.max_tilt_deg}")
    if hints.heading_tolerance_deg is not None and not 0 < hints.heading_tolerance_deg <= 180:
        raise OptionsError(
            f"hints.heading_tolerance_deg: expected more than 0 up to 180, got {hints.heading_tolerance_deg}"
        )
    if hints.region is not None and not all(low < high for low, high in zip(*hints.region, strict=True)):
        raise OptionsError(f"hints.region: expected min below max on every axis, got {hints.region}")
