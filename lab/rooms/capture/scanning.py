"""A scanner on a tripod: points only where its stations see, with noise on range and color."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.rooms.capture.free_space import scanner_positions
from panoloc.lab.rooms.capture.ray_imaging import label_colors, shade
from panoloc.lab.rooms.materials.labels import label_number
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.surface import Hits

_COLOR_NOISE = 0.012
_GLASS_RETURNS = 0.3
_WINDOW = label_number("window")


@dataclass(frozen=True, eq=False)
class Scan:
    """A point cloud with the truth about it: the exact hits (N,) and their surface points (N, 3), stations (S, 3)."""

    cloud: PointCloud
    hits: Hits
    exact_positions: NDArray[np.float64]
    stations: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Rays:
    """What rays of several stations meet: hits (N,) along unit directions (N, 3), and the number of each ray's station (N,)."""

    hits: Hits
    directions: NDArray[np.float64]
    station: NDArray[np.int64]

    def ends(self, stations: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the points (N, 3) that rays from stations (S, 3) meet."""
        return np.asarray(stations[self.station] + self.directions * self.hits.distance[:, None])


def scan_with_truth(
    scene: Scene,
    num_stations: int | None = None,
    num_points: int = 300_000,
    noise_m: float = 0.004,
    seed: int = 0,
    color_kind: str = "rgb",
) -> Scan:
    """Scan the scene from `num_stations` places spread over its free space, None for as many as its area asks for.

    Points are thinned so that near and far surfaces are about equally dense, as merged survey scans are.
    noise_m: standard deviation of the range. color_kind "labels" gives exact label colors.
    """
    rng = np.random.default_rng((seed, 7))
    stations = scanner_positions(scene, num_stations, rng)
    rays = cast_rays(scene, stations, num_points, rng)
    hits, directions, exact = rays.hits, rays.directions, rays.ends(stations)
    measured = exact + directions * rng.normal(0, noise_m, (len(exact), 1))
    if color_kind == "labels":
        colors = label_colors(scene, hits)
    else:
        color = shade(scene, hits, directions, np.full(len(exact), 0.008, np.float32))
        colors = (np.clip(color + rng.normal(0, _COLOR_NOISE, color.shape), 0, 1) * 255 + 0.5).astype(np.uint8)
    cloud = PointCloud(measured.astype(np.float32), colors, num_points_read=len(exact))
    return Scan(cloud, hits, exact, stations)


def scan_scene(
    scene: Scene, num_stations: int | None = None, num_points: int = 300_000, seed: int = 0, color_kind: str = "rgb"
) -> PointCloud:
    """Return the point cloud of `scan_with_truth`."""
    return scan_with_truth(scene, num_stations, num_points, seed=seed, color_kind=color_kind).cloud


def cast_rays(
    scene: Scene,
    stations: NDArray[np.float64],
    num_points: int,
    rng: np.random.Generator,
    returns: Callable[[Rays], NDArray[np.float32]] | None = None,
    surplus: float = 1.7,
) -> Rays:
    """Cast rays in all directions from stations (S, 3) and keep `num_points` of those that meet something.

    returns: share in 0..1 (N,) of rays that come back, None for all. surplus: rays cast per ray kept.
    """
    # Directions are uniform on the sphere, so near surfaces get more points; some of those are dropped again.
    per_station = int(num_points / len(stations) * surplus) + 1000
    station = np.repeat(np.arange(len(stations)), per_station)
    directions = rng.normal(size=(len(station), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = scene.surface.cast(stations[station], directions)
    share = 1.0 if returns is None else returns(Rays(hits, directions, station))
    chosen = _choose(scene, hits, directions, share, num_points, rng)
    hits = Hits(hits.distance[chosen], hits.triangle[chosen], hits.weights[chosen])
    return Rays(hits, directions[chosen], station[chosen])


def _choose(
    scene: Scene,
    hits: Hits,
    directions: NDArray[np.float64],
    share: NDArray[np.float32] | float,
    num_points: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Draw at most `num_points` hits, favouring sparse (far, grazing) surfaces; most rays on glass do not return.

    share: of the rays that come back, (N,) or one for all.
    """
    cosine = np.abs((scene.surface.normals[hits.triangle] * directions).sum(1))
    area_per_ray = np.where(hits.found, hits.distance, 0) ** 2 / np.maximum(cosine, 0.05)
    weight = np.minimum(area_per_ray, np.quantile(area_per_ray[hits.found], 0.7)) * hits.found * share
    glass = hits.found & (scene.surface.label[hits.triangle] == _WINDOW)
    weight = np.where(glass, weight * _GLASS_RETURNS, weight)
    # Exponential races: the smallest of e_i / w_i are a weighted draw without replacement.
    with np.errstate(divide="ignore"):
        race = rng.exponential(size=len(weight)) / weight
    count = min(num_points, int((weight > 0).sum()))
    return np.sort(np.argpartition(race, count - 1)[:count])
