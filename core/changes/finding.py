"""From a scan and photos with poses to a list of changes: the order of the steps is written here.

Each photo is compared with the scan from its pose; space becomes voxels that the photos around have their say on; a small network tells
where the middles of things are that came or went; what went and came again moved.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from hashlib import sha256
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from panoloc.core.camera.rig import Panorama
from panoloc.core.changes.config import CHANGES
from panoloc.core.changes.evidence import PhotoEvidence, photo_evidence
from panoloc.core.changes.network import MULTIPLE, VoxelNetwork, fitted_network
from panoloc.core.changes.objects import PlacedObject, pair_up, placed_objects, without_repeats
from panoloc.core.changes.voxels import LEAST_CHANGED, VoxelGrid, voxel_features
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.projection import pixels_towards
from panoloc.core.render.render_cloud import make_render_cloud, point_spacing
from panoloc.core.scan.point_cloud import PointCloud

Kind = Literal["came", "went", "moved"]


@dataclass(frozen=True, eq=False)
class DatedPhoto:
    """A photo on the sphere, map_from_camera, and when it was taken, or came to the service."""

    panorama: Panorama
    pose: Pose
    time: datetime


@dataclass(frozen=True, eq=False)
class Change:
    """An object that came, went or moved, in the map's own frame, metres.

    id: of 12 hex digits, from kind and place. center, size: (3,) of its box along the map's axes; of what moved where it is now.
    from_center: (3,) where it was, of what moved. certainty: 0..1, how probable it is that the object changed as is said.
    photos: numbers of the photos that saw the change; the one that shows most of the object first.
    """

    id: str
    kind: Kind
    center: NDArray[np.float64]
    size: NDArray[np.float64]
    from_center: NDArray[np.float64] | None
    certainty: float
    photos: tuple[int, ...]


def find_changes(cloud: PointCloud, photos: Sequence[DatedPhoto]) -> list[Change]:
    """Return what changed, the surest first."""
    if not photos:
        return []
    points, colors = torch.from_numpy(cloud.positions), torch.from_numpy(cloud.colors).float() / 255
    rendered = make_render_cloud(points, colors, point_spacing(points))
    seen = [photo_evidence(rendered, each.panorama, in_cloud(each.pose, cloud)) for each in photos]
    placed = _placed_objects(fitted_network(), cloud.positions, colors.numpy(), seen)
    large = [each for each in placed if each.size.max() >= CHANGES.least_side_m]
    witnessed = [pair for pair in ((each, _witnesses(each, seen)) for each in large) if pair[1]]
    went, came = ([pair for pair in witnessed if pair[0].is_new is is_new] for is_new in (False, True))
    moved = pair_up([each for each, _ in went], [each for each, _ in came])
    offset = np.asarray(cloud.origin_offset, np.float64)
    found = [_moved(went[i], came[j], offset) for i, j in moved]
    found += [_alone(each, "went", offset) for k, each in enumerate(went) if all(k != i for i, _ in moved)]
    found += [_alone(each, "came", offset) for k, each in enumerate(came) if all(k != j for _, j in moved)]
    return sorted(found, key=lambda each: -each.certainty)


def _placed_objects(
    network: VoxelNetwork, points: NDArray[np.float32], colors: NDArray[np.float32], seen: Sequence[PhotoEvidence]
) -> list[PlacedObject]:
    """Return what came and what went. points, colors: (N, 3) of the scan, colours 0..1. seen: what photos say, in any order."""
    found: list[PlacedObject] = []
    for grid, inner in _tiles(points, seen):
        features = voxel_features(grid, points, colors, _nearest(grid, seen))
        if bool((features[LEAST_CHANGED] > CHANGES.least_changed).any()):
            with torch.inference_mode():
                said = network(features[None])[0]
            for row in (0, 1):
                found += placed_objects(said[row], features, grid, inner, is_new=row == 1)
    return without_repeats(found)


def _nearest(grid: VoxelGrid, seen: Sequence[PhotoEvidence]) -> list[PhotoEvidence]:
    """Return the photos taken nearest to the middle of a tile: far ones add time, not knowledge."""
    middle = torch.from_numpy(grid.low + np.array(grid.shape) * grid.side / 2).float()
    return sorted(seen, key=lambda each: float((each.center - middle).norm()))[: CHANGES.most_photos]


def _tiles(points: NDArray[np.float32], seen: Sequence[PhotoEvidence]) -> Iterator[tuple[VoxelGrid, tuple[slice, ...]]]:
    """Yield grids that overlap, within reach of the cameras, and for which of their voxels each is there."""
    centers = np.stack([each.center.numpy() for each in seen])
    within = [np.quantile(points, q, axis=0) + s * 1.5 * CHANGES.voxel_m for q, s in ((0.0005, -1), (0.9995, 1))]
    low = np.maximum(within[0], centers.min(0) - CHANGES.reach_m)
    high = np.minimum(within[1], centers.max(0) + CHANGES.reach_m)
    side, size, margin = CHANGES.voxel_m, CHANGES.tile, CHANGES.margin
    shape = np.maximum(np.ceil((high - low) / side).astype(int), 1)
    starts = [range(0, count, size) for count in shape]
    for corner in np.array(np.meshgrid(*starts, indexing="ij")).reshape(3, -1).T:
        first, last = np.maximum(corner - margin, 0), np.minimum(corner + size + margin, shape)
        padded = np.ceil((last - first) / MULTIPLE).astype(int) * MULTIPLE
        grid = VoxelGrid(low + first * side, (int(padded[0]), int(padded[1]), int(padded[2])), side)
        inner = tuple(
            slice(int(a), int(b)) for a, b in zip(corner - first, np.minimum(corner + size, shape) - first, strict=True)
        )
        yield grid, inner


def in_cloud(map_from_camera: Pose, cloud: PointCloud) -> Pose:
    """Return a pose in the axes of a cloud without its offset."""
    return Pose(map_from_camera.rotation, map_from_camera.position - cloud.origin_offset)


def _witnesses(placed: PlacedObject, seen: Sequence[PhotoEvidence]) -> tuple[int, ...]:
    """Return the numbers of the photos that saw the change, the one that shows most of it first."""
    voxels = torch.from_numpy(placed.voxels).float()
    shown: list[tuple[float, int]] = []
    for number, each in enumerate(seen):
        relative = voxels - each.center
        distance, pixel = relative.norm(dim=1), pixels_towards(relative, CHANGES.rows)
        open_ = each.known.flatten()[pixel] & (distance <= each.depth.flatten()[pixel] + CHANGES.surface_m)
        open_ &= distance < CHANGES.reach_m
        if float(open_.float().mean()) < CHANGES.seen_share:
            continue
        if float(each.changed.flatten()[pixel][open_].mean()) > CHANGES.seen_changed:
            shown.append((-float(len(torch.unique(pixel[open_]))), number))
    return tuple(number for _, number in sorted(shown))


_Witnessed = tuple[PlacedObject, tuple[int, ...]]


def _alone(witnessed: _Witnessed, kind: Kind, offset: NDArray[np.float64]) -> Change:
    placed, photos = witnessed
    return Change(_id_of(kind, placed), kind, placed.center + offset, placed.size, None, placed.certainty, photos)


def _moved(went: _Witnessed, came: _Witnessed, offset: NDArray[np.float64]) -> Change:
    """Return both as one, no surer than the less sure of them."""
    certainty = min(went[0].certainty, came[0].certainty)
    photos = tuple(dict.fromkeys((*came[1], *went[1])))
    now, before = came[0], went[0].center + offset
    return Change(_id_of("moved", now), "moved", now.center + offset, now.size, before, certainty, photos)


def _id_of(kind: Kind, placed: PlacedObject) -> str:
    place = " ".join(f"{value:.2f}" for value in placed.center)
    return sha256(f"{kind} {place}".encode()).hexdigest()[:12]
