"""What changed between two scenes: which pixels show, and which scanned points lie on, a surface that the other scene does not have; and
which things came, went or moved.

A surface is absent from the other scene when its object is not there at the same place, or when it is hidden there:
inside a solid or under something that lies on it, as the floor under a carpet.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.lab.rooms.capture.scanning import Scan
from panoloc.lab.rooms.capture.views import View, take_view
from panoloc.lab.rooms.objects.objects import SceneObject
from panoloc.lab.rooms.scenes.scene import Scene, kept_objects
from panoloc.lab.rooms.scenes.surface import Hits

_COVER_M = 0.03
_VIEW_WIDTH = 512
_POINT_M2 = 0.002


@dataclass(frozen=True, eq=False)
class ChangedObject:
    """A thing at a place where it was not, or is no longer.

    name: of the sort of thing. is_new: it came there; else it went from there. moved: the same thing went from, or came to, another
    place. low, high: (3,) corners of its box, metres. points: (M, 3) spread over its surface. seen_sr: solid angle that it takes in the
    photo that shows most of it, or would if it still stood there. num_points: of the scan that lie on it.
    """

    name: str
    is_new: bool
    moved: bool
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    points: NDArray[np.float64]
    seen_sr: float
    num_points: int

    @property
    def center(self) -> NDArray[np.float64]:
        """Return the middle of the box, (3,)."""
        return (self.low + self.high) / 2

    @property
    def largest_side_m(self) -> float:
        """Return the length of the longest edge of the box."""
        return float((self.high - self.low).max())


def changed_pixels(view: View, seen: Scene, scanned: Scene) -> NDArray[np.bool_]:
    """Return (H, W) bool: the pixel of a view of `seen` shows what is not in `scanned`. Sky never counts as changed."""
    points = view.pose.position + view.directions * np.where(view.hits.found, view.hits.distance, 0)[:, None]
    return _absent(points, view.hits, seen, scanned).reshape(view.panorama.valid.shape)


def changed_points(scan: Scan, scanned: Scene, now: Scene) -> NDArray[np.bool_]:
    """Return (N,) bool: the surface of the point of a scan of `scanned` is no longer in `now`."""
    return _absent(scan.exact_positions, scan.hits, scanned, now)


def _absent(points: NDArray[np.float64], hits: Hits, own: Scene, other: Scene) -> NDArray[np.bool_]:
    kept = kept_objects(own, other)[own.surface.object_index[hits.triangle]]
    absent = hits.found & ~kept
    rest = np.flatnonzero(hits.found & kept)
    normals = own.surface.normals[hits.triangle[rest]]
    hidden = _hidden(points[rest], normals, other)
    # What stands as close in the own scene did not keep the point from being seen.
    doubtful = np.flatnonzero(hidden)
    hidden[doubtful] = ~_hidden(points[rest[doubtful]], normals[doubtful], own)
    absent[rest] = hidden
    return absent


def _hidden(points: NDArray[np.float64], normals: NDArray[np.float32], scene: Scene) -> NDArray[np.bool_]:
    """Return which points (N, 3) of surfaces with `normals` lie inside a solid of `scene` or directly under something."""
    cover = scene.surface.cast(points + normals * 0.002, normals)
    from_inside = (scene.surface.normals[cover.triangle] * normals).sum(1) > 0
    hidden: NDArray[np.bool_] = cover.found & (from_inside | (cover.distance < _COVER_M))
    return hidden


def changed_objects(scan: Scan, scanned: Scene, now: Scene, poses: Sequence[Pose]) -> list[ChangedObject]:
    """Return what came and went between `scanned` and `now`. poses: map_from_camera of the photos of `now`."""
    went = _absent_things(scanned, now, poses, is_new=False)
    came = _absent_things(now, scanned, poses, is_new=True)
    points = np.bincount(scanned.surface.object_index[scan.hits.triangle], minlength=len(scanned.objects))
    num_points = {id(thing): int(count) for thing, count in zip(scanned.objects, points, strict=True)}
    told_apart = {_identity(thing) for thing, _ in went} & {_identity(thing) for thing, _ in came}
    return [
        _described(thing, seen, is_new, _identity(thing) in told_apart, 0 if is_new else num_points[id(thing)])
        for is_new, things in ((False, went), (True, came))
        for thing, seen in things
    ]


def _absent_things(own: Scene, other: Scene, poses: Sequence[Pose], is_new: bool) -> list[tuple[SceneObject, float]]:
    """Return the things of a scene that the other lacks, with the largest solid angle in which a pose sees each."""
    seen = np.zeros(len(own.objects))
    for pose in poses:
        view = take_view(own, Pose(np.eye(3), pose.position), _VIEW_WIDTH, "labels")
        height = _VIEW_WIDTH // 2
        rows = np.cos(np.pi / 2 - np.pi * (np.arange(height) + 0.5) / height) * (np.pi / height) ** 2
        hit = view.hits.found
        index = own.surface.object_index[view.hits.triangle[hit]]
        angles = np.repeat(rows, _VIEW_WIDTH)[hit]
        seen = np.maximum(seen, np.bincount(index, angles, len(own.objects)))
    kept = kept_objects(own, other)
    return [(thing, float(seen[k])) for k, thing in enumerate(own.objects) if not kept[k]]


def _identity(thing: SceneObject) -> object:
    """Return what a thing has in common with itself at another place: its item; of a door leaf, its key without the angle."""
    return thing.key.partition("~")[0] if thing.item is None else id(thing.item)


def _described(thing: SceneObject, seen_sr: float, is_new: bool, moved: bool, num_points: int) -> ChangedObject:
    vertices = np.concatenate([part.vertices for piece in thing.pieces for part in piece.parts])
    name = "door" if thing.item is None else thing.item.name
    low, high = vertices.min(0), vertices.max(0)
    return ChangedObject(name, is_new, moved, low, high, _spread(thing), seen_sr, num_points)


def _spread(thing: SceneObject) -> NDArray[np.float64]:
    """Return points (M, 3) drawn evenly over the surface of a thing."""
    corners = np.concatenate([part.vertices[part.triangles] for piece in thing.pieces for part in piece.parts])
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.linalg.norm(np.cross(first, second), axis=1) / 2
    number = np.repeat(np.arange(len(area)), np.ceil(area / _POINT_M2).astype(int))
    share = np.random.default_rng(0).random((2, len(number), 1))
    share = np.where(share.sum(0) > 1, 1 - share, share)
    return np.asarray(corners[number, 0] + share[0] * first[number] + share[1] * second[number])
