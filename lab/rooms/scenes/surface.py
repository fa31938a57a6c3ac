"""All triangles of a scene in flat arrays, and what a ray meets on them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CoreError
from panoloc.lab.rooms.materials.labels import label_number
from panoloc.lab.rooms.materials.texture import Texture, TextureAtlas
from panoloc.lab.rooms.objects.objects import SceneObject


class RayCasterMissingError(CoreError):
    """Open3D is not installed, or a system library that it loads is not."""


def load_open3d() -> ModuleType:
    """Return Open3D, which casts the rays. Raises RayCasterMissingError, which says how to get it.

    It is loaded when the first rays are cast, because that takes a second and 130 MB.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:  # OSError: of a system library that Open3D loads
        raise RayCasterMissingError(
            f"expected Open3D, which renders procedural rooms, but it cannot be loaded ({error}); scripts/install installs it with "
            "the system libraries that it needs. The service, and scans of your own, work without it"
        ) from error
    module: ModuleType = open3d
    return module


@dataclass(frozen=True, eq=False)
class Hits:
    """What N rays meet.

    distance: (N,) float32 metres, inf for nothing. triangle: (N,) int64, −1 for nothing.
    weights: (N, 3) float32 barycentric weights of the triangle's corners.
    """

    distance: NDArray[np.float32]
    triangle: NDArray[np.int64]
    weights: NDArray[np.float32]

    @property
    def found(self) -> NDArray[np.bool_]:
        """Return which rays meet something, (N,)."""
        return self.triangle >= 0


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with what is known about them.

    vertices (V, 3), uv_m (V, 2) float32; triangles (T, 3) int64; per triangle: normals (T, 3) float32,
    texture, object_index, label (T,) int64 and glow (T,) float32.
    """

    vertices: NDArray[np.float32]
    uv_m: NDArray[np.float32]
    triangles: NDArray[np.int64]
    normals: NDArray[np.float32]
    texture: NDArray[np.int64]
    object_index: NDArray[np.int64]
    label: NDArray[np.int64]
    glow: NDArray[np.float32]
    atlas: TextureAtlas

    @cached_property
    def _ray_casting(self) -> Any:
        open3d = load_open3d()
        scene = open3d.t.geometry.RaycastingScene(nthreads=0)
        scene.add_triangles(
            open3d.core.Tensor.from_numpy(np.ascontiguousarray(self.vertices)),
            open3d.core.Tensor.from_numpy(self.triangles.astype(np.uint32)),
        )
        return scene

    def cast(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> Hits:
        """Return what rays from `origins` (3,) or (N, 3) along unit `directions` (N, 3) meet first."""
        rays = _rays(origins, directions)
        answer = self._ray_casting.cast_rays(rays)
        distance = answer["t_hit"].numpy()
        found = np.isfinite(distance)
        triangle = np.where(found, answer["primitive_ids"].numpy().astype(np.int64), -1)
        second, third = answer["primitive_uvs"].numpy().T
        return Hits(distance, triangle, np.stack((1 - second - third, second, third), axis=1))

    def blocked(self, starts: NDArray[np.floating], ends: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Return for each pair of points (N, 3) whether something lies between them."""
        rays = _rays(starts, ends - starts)
        occluded: NDArray[np.bool_] = self._ray_casting.test_occlusions(rays, tnear=0.0, tfar=0.999).numpy()
        return occluded

    def clearance(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the distance in metres of points (N, 3) to the nearest surface."""
        distance: NDArray[np.float32] = self._ray_casting.compute_distance(_tensor(points)).numpy()
        return distance

    def at_hits(self, per_vertex: NDArray[np.float32], hits: Hits) -> NDArray[np.float32]:
        """Interpolate values given per vertex (V, C) at hits that all met something, (N, C)."""
        corners = self.triangles[hits.triangle]
        total = per_vertex[corners[:, 0]] * hits.weights[:, :1]
        total += per_vertex[corners[:, 1]] * hits.weights[:, 1:2]
        total += per_vertex[corners[:, 2]] * hits.weights[:, 2:]
        return total


def assemble(objects: Sequence[SceneObject]) -> Surface:
    """Put the parts of all objects into flat arrays; equal textures are stored once."""
    textures: dict[int, tuple[int, Texture]] = {}
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in ("vertices", "uv", "triangles", "normals")}
    per_part: list[tuple[int, int, int, float]] = []
    num_vertices, counts = 0, []
    for index, thing in enumerate(objects):
        for piece in thing.pieces:
            label = label_number(piece.label)
            for part in piece.parts:
                texture, _ = textures.setdefault(id(part.texture), (len(textures), part.texture))
                columns["vertices"].append(part.vertices)
                columns["uv"].append(part.uv_m)
                columns["triangles"].append(part.triangles + num_vertices)
                corner = part.vertices[part.triangles]
                columns["normals"].append(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
                per_part.append((texture, index, label, part.glow))
                counts.append(len(part.triangles))
                num_vertices += len(part.vertices)
    normals = np.concatenate(columns["normals"])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    details = np.repeat(np.array(per_part), counts, axis=0)
    whole = details[:, :3].astype(np.int64)
    return Surface(
        np.concatenate(columns["vertices"]).astype(np.float32),
        np.concatenate(columns["uv"]).astype(np.float32),
        np.concatenate(columns["triangles"]),
        normals.astype(np.float32),
        whole[:, 0],
        whole[:, 1],
        whole[:, 2],
        details[:, 3].astype(np.float32),
        TextureAtlas([texture for _, texture in textures.values()]),
    )


def _tensor(values: NDArray[np.floating]) -> Any:
    return load_open3d().core.Tensor.from_numpy(np.ascontiguousarray(values, np.float32))


def _rays(origins: NDArray[np.floating], directions: NDArray[np.floating]) -> Any:
    rays = np.empty((len(directions), 6), np.float32)
    rays[:, :3], rays[:, 3:] = origins, directions
    return _tensor(rays)
