"""Panoramas and photos whose poses are known, grouped by the scan that they belong to: what every source of cases yields."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.errors import CoreError
from panoloc.core.geometry.pose import Pose, PoseError, pose_error
from panoloc.core.image.photo_window import rig_on_sphere
from panoloc.core.options import Hints, IndexOptions
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.evaluation.rows import WRONG


class SourceError(CoreError):
    """Cases are not where they were expected, or not in the expected form. The message names the file and the form."""


def known_pose(rotation: NDArray[np.float64], position: NDArray[np.float64], where: Path | str) -> Pose:
    """Return a pose after checking that `rotation` (3, 3) is one and `position` (3,) finite; raises SourceError that names `where`."""
    is_rotation = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    if not is_rotation or not np.isfinite(position).all():
        raise SourceError(f"{where}: expected an orthonormal right-handed rotation and a finite position")
    return Pose(rotation, position)


@dataclass(frozen=True, eq=False)
class KnownQuery:
    """One query with its truth: a full panorama, or the photos of a session.

    poses: map_from_camera, of a session that of its first image, in the scan's own frame; more than one where a place exists twice and
    each is as right as the others. changed_pixels: (H, W) bool, shows what was not scanned; changed_points: (N,) bool by point of the
    cloud, no longer there; None where unknown. tags describe the query. hints: of the call.
    aliases: map_from_camera at which another room looks most like this one, and is not.
    """

    query: Rig
    poses: tuple[Pose, ...]
    changed_pixels: NDArray[np.bool_] | None = None
    changed_points: NDArray[np.bool_] | None = None
    tags: tuple[str, ...] = ()
    hints: Hints | None = None
    aliases: tuple[Pose, ...] = ()

    @cached_property
    def panorama(self) -> Panorama:
        """Return the query as one panorama: that of a rig from `rig_on_sphere`."""
        return rig_on_sphere(self.query)

    def place_of(self, found: Pose) -> str | None:
        """Return which of rooms that are alike a pose is in: "own" or "other", or "elsewhere"; None where there are none."""
        others = (*self.poses[1:], *self.aliases)
        if not others:
            return None
        if pose_error(found, self.poses[0]).position_m <= WRONG[0]:
            return "own"
        return "other" if any(pose_error(found, other).position_m <= WRONG[0] for other in others) else "elsewhere"

    def error_of(self, found: Pose) -> PoseError:
        """Return the error against the nearest of the right poses."""
        return min((pose_error(found, known) for known in self.poses), key=lambda error: error.position_m)


@dataclass(frozen=True, eq=False)
class LoadedScan:
    """A scan in memory: its cloud, how to build its map, and a function that loads one of its queries by name."""

    cloud: PointCloud
    options: IndexOptions
    query: Callable[[str], KnownQuery]


@dataclass(frozen=True, eq=False)
class ScanCases:
    """A scan and the names of its panoramas; nothing is read before `load` is called.

    group: the suite, folder or split whose tables its rows belong to. place: scans with the same place show the same rooms, so that a
    panorama of one is no stranger to the other. facts go into every row as they are (JSON-safe), such as the scene family.
    """

    name: str
    group: str
    query_names: tuple[str, ...]
    load: Callable[[], LoadedScan]
    place: str
    facts: dict[str, Any] = field(default_factory=dict)


def limited(scans: Sequence[ScanCases], limit: int | None) -> list[ScanCases]:
    """Return the scans with at most `limit` queries per group, the first ones; None for all."""
    if limit is None:
        return list(scans)
    kept: list[ScanCases] = []
    for scan in scans:
        names = scan.query_names[: max(0, limit - sum(len(one.query_names) for one in kept if one.group == scan.group))]
        if names:
            kept.append(ScanCases(scan.name, scan.group, names, scan.load, scan.place, scan.facts))
    return kept


def query_facts(query: KnownQuery) -> dict[str, Any]:
    """Return `camera`, `num_images`, `hfov_deg` of the first image, and `upright`.

    upright: "hint" where the camera is said to be level, "session" where the session knows its up axis, else None.
    """
    said = query.query
    known = "hint" if query.hints is not None and query.hints.upright else None
    camera = said.images[0].photo.camera
    return {
        "camera": "panorama" if camera.is_whole_sphere else camera.model,
        "num_images": len(said.images),
        "hfov_deg": round(camera.hfov_deg, 1),
        "upright": known or ("session" if said.options.up_known else None),
    }
