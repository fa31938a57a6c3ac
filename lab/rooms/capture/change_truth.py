"""Which pixels show, and which scanned points lie on, a surface that the other scene does not have.

A surface is absent from the other scene when its object is not there at the same place, or when it is hidden there:
inside a solid or under something that lies on it, as the floor under a carpet.
"""

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.capture.scanning import Scan
from panoloc.lab.rooms.capture.views import View
from panoloc.lab.rooms.scenes.scene import Scene, kept_objects
from panoloc.lab.rooms.scenes.surface import Hits

_COVER_M = 0.03


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
