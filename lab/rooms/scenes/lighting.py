"""Light baked into the vertices: lamps and windows with soft shadows, then light that bounces between surfaces.

Because it is baked, a point has the same color for every scan and panorama.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.objects.objects import Light
from panoloc.lab.rooms.scenes.surface import Surface

_NUM_BOUNCE_RAYS = 32
_NUM_BOUNCES = 3
_LIFT_M = 0.012
_PULL = 0.3
_REACH_M = 12.0
_BURIED_SHARE = 0.4
_NUM_FILLS = 2
_SUN_REACH_M = 150.0


@dataclass(frozen=True)
class Sky:
    """Light from where nothing is: linear RGB radiance overhead and at the horizon."""

    zenith: tuple[float, float, float] = (0.0, 0.0, 0.0)
    horizon: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def radiance(self, directions: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the linear RGB radiance (N, 3) seen along unit directions (N, 3)."""
        height = np.clip(directions[:, 2:], 0, 1) ** 0.6
        return np.asarray(np.asarray(self.horizon) * (1 - height) + np.asarray(self.zenith) * height, np.float32)


def bake_light(surface: Surface, lights: Sequence[Light], sky: Sky) -> NDArray[np.float32]:
    """Return the linear RGB irradiance (V, 3) at every vertex, so that color = reflectance x irradiance."""
    normals = _vertex_normals(surface)
    points = _pulled_inwards(surface) + normals * _LIFT_M
    direct = np.zeros_like(points)
    for light in lights:
        direct += _from_light(surface, points, normals, light)
    return _bounced(surface, points, normals, direct, sky)


def exposure_of(surface: Surface, irradiance: NDArray[np.float32], target: float = 0.3) -> float:
    """Return the factor that brings the mean reflected light, weighted by area, to `target`."""
    corner = surface.vertices[surface.triangles]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    reflected = irradiance[surface.triangles].mean(1) * surface.atlas.mean_albedo[surface.texture]
    lit = area * (surface.glow == 0)
    return target / float(np.maximum((reflected.mean(1) * lit).sum() / lit.sum(), 1e-6))


def _from_light(
    surface: Surface, points: NDArray[np.float32], normals: NDArray[np.float32], light: Light
) -> NDArray[np.float32]:
    if light.sun:
        return _from_sun(surface, points, normals, light)
    received = np.zeros(len(points))
    for source in light.points:
        toward = source - points
        distance = np.linalg.norm(toward, axis=1)
        cosine = (toward * normals).sum(1) / np.maximum(distance, 1e-6)
        if light.normal is not None:
            cosine = cosine * np.clip(-(toward @ light.normal) / np.maximum(distance, 1e-6), 0, 1)
        amount = np.clip(cosine, 0, 1) / (distance**2 + 0.15)
        near = np.flatnonzero((amount > 1e-4) & (distance < _REACH_M))
        shadow = surface.blocked(points[near], np.broadcast_to(source, (len(near), 3)))
        received[near] += amount[near] * ~shadow
    return np.asarray(received[:, None] / len(light.points) * light.power, np.float32)


def _from_sun(
    surface: Surface, points: NDArray[np.float32], normals: NDArray[np.float32], light: Light
) -> NDArray[np.float32]:
    toward = light.points[0] / np.linalg.norm(light.points[0])
    cosine = np.clip(normals @ toward, 0, 1)
    lit = np.flatnonzero(cosine > 0)
    free = ~surface.blocked(points[lit], points[lit] + toward * _SUN_REACH_M)
    received = np.zeros(len(points))
    received[lit] = cosine[lit] * free
    return np.asarray(received[:, None] * light.power, np.float32)


def _bounced(
    surface: Surface, points: NDArray[np.float32], normals: NDArray[np.float32], direct: NDArray[np.float32], sky: Sky
) -> NDArray[np.float32]:
    """Return direct light plus what other surfaces and the sky send; vertices inside solids take it from their neighbours."""
    directions = _cosine_directions(normals).reshape(-1, 3)
    hits = surface.cast(np.repeat(points, _NUM_BOUNCE_RAYS, axis=0), directions)
    met = np.maximum(hits.triangle, 0)
    facing = hits.found & ((surface.normals[met] * directions).sum(1) < 0)
    buried = (hits.found & ~facing).reshape(-1, _NUM_BOUNCE_RAYS).mean(1) > _BURIED_SHARE
    from_sky = np.where(hits.found[:, None], 0, sky.radiance(directions)).astype(np.float32)
    albedo = surface.atlas.mean_albedo[surface.texture].astype(np.float32)
    total = _unburied(surface, direct, buried)
    for _ in range(_NUM_BOUNCES):
        radiance = total[surface.triangles].mean(1) * albedo
        arriving = np.where(facing[:, None], radiance[met], 0) + from_sky
        total = _unburied(surface, direct + arriving.reshape(len(points), _NUM_BOUNCE_RAYS, 3).mean(1), buried)
    return total


def _unburied(surface: Surface, light: NDArray[np.float32], buried: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the light with that of vertices inside solids replaced by the mean of their triangles' other corners."""
    known = (~buried).astype(np.float32)[:, None]
    light = light * known
    for _ in range(_NUM_FILLS):
        count, total = (_summed(surface, values[surface.triangles].sum(1)) for values in (known, light))
        fill = (known == 0) & (count > 0)
        light = np.where(fill, total / np.maximum(count, 1), light)
        known = np.where(fill, 1, known).astype(np.float32)
    return np.asarray(light, np.float32)


def _summed(surface: Surface, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the sums (V, C) of what belongs to the triangles (T, C) that meet at each vertex."""
    total = np.zeros((len(surface.vertices), values.shape[1]), np.float32)
    for corner in range(3):
        np.add.at(total, surface.triangles[:, corner], values)
    return total


def _pulled_inwards(surface: Surface) -> NDArray[np.float32]:
    """Return the vertices (V, 3) moved a little into their faces, so that they do not lie on the next wall."""
    centers = surface.vertices[surface.triangles].mean(1)
    total, count = _summed(surface, centers), _summed(surface, np.ones((len(centers), 1), np.float32))
    mean = np.where(count > 0, total / np.maximum(count, 1), surface.vertices)
    return np.asarray(surface.vertices + _PULL * (mean - surface.vertices), np.float32)


def _vertex_normals(surface: Surface) -> NDArray[np.float32]:
    total = _summed(surface, surface.normals)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9), np.float32)


def _cosine_directions(normals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (V, rays, 3) directions: the same cosine-weighted spiral around every normal, hence no noise."""
    step = np.arange(_NUM_BOUNCE_RAYS) + 0.5
    radius, angle = np.sqrt(step / _NUM_BOUNCE_RAYS), step * 2.399963
    local = np.stack((radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1 - radius**2)), axis=1)
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0, 1]], [[1.0, 0, 0]])
    u = np.cross(helper, normals)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-9)
    frame = np.stack((u, np.cross(normals, u), normals), axis=1)
    return np.asarray(np.einsum("rk,vkc->vrc", local, frame), np.float32)
