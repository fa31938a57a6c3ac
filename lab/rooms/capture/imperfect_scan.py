"""An imperfect scan, as a depth camera gives it: stations that drift, holes, misplaced colors, boxes for furniture."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.rooms.capture.free_space import scanner_positions
from panoloc.lab.rooms.capture.ray_imaging import label_colors, shade
from panoloc.lab.rooms.capture.scanning import Rays, Scan, cast_rays
from panoloc.lab.rooms.capture.shooting import rotation_of
from panoloc.lab.rooms.materials.labels import label_number
from panoloc.lab.rooms.materials.texture import plain
from panoloc.lab.rooms.objects.objects import Piece, SceneObject, placed
from panoloc.lab.rooms.objects.solids import about_z, box
from panoloc.lab.rooms.scenes.changes import another_day
from panoloc.lab.rooms.scenes.scene import Scene

Range = tuple[float, float]
_CEILING, _SCREEN = label_number("ceiling"), label_number("screen")
_SURPLUS = 4.0
_SHINY = 0.7  # share of a screen that is lost
_NUM_WAVES = 6
_NUM_TRIES = 1000
_STANDING = ("wall", "middle", "corner")  # anchors of furniture that can be a box


@dataclass(frozen=True)
class Imperfections:
    """How far a scan is from an exact one; a pair is the range of values, drawn per station unless it says otherwise.

    drift_m, drift_deg: between any two stations, in their middle. noise_m: standard deviation of the range.
    blind_deg: wedge about the vertical that a station does not see. reach_m: beyond it fewer rays return.
    holes_per_m2: number per floor area. hole_m: radius of each. ceiling_gone: share of a room's ceiling.
    glancing_deg: angle to the surface below which fewer rays return. dark_albedo: linear, below it patches do not return.
    exposure: factor. white_balance: factors of red and blue. vignetting: share of light lost in the corners of an image.
    blur_m: width over which a color is averaged. color_shift_m: of colors along the surface. color_noise: standard
    deviation in 0..1, of each point. boxes: share of the furniture that is a box.
    """

    drift_m: Range = (0.01, 0.05)
    drift_deg: Range = (0.1, 0.5)
    noise_m: Range = (0.003, 0.01)
    blind_deg: Range = (40.0, 120.0)
    reach_m: float = 5.0
    holes_per_m2: float = 1.5
    hole_m: Range = (0.1, 0.4)
    ceiling_gone: Range = (0.1, 0.5)
    glancing_deg: float = 12.0
    dark_albedo: float = 0.06
    exposure: Range = (0.75, 1.25)
    white_balance: Range = (0.9, 1.1)
    vignetting: Range = (0.05, 0.3)
    blur_m: Range = (0.006, 0.04)
    color_shift_m: Range = (0.005, 0.02)
    color_noise: float = 0.02
    boxes: float = 0.25


@dataclass(frozen=True, eq=False)
class ImperfectScan:
    """A scan with its recipe: the scene as it was scanned, station (N,) of each point, map_from_station drifts (S,) of zero mean."""

    scan: Scan
    scene: Scene
    station: NDArray[np.int64]
    drifts: tuple[Pose, ...]


def scan_imperfectly(
    scene: Scene,
    how: Imperfections,
    num_stations: int | None = None,
    num_points: int = 300_000,
    seed: int = 0,
    color_kind: str = "rgb",
) -> ImperfectScan:
    """Scan the scene on another day; the drifts have zero mean over the stations, so the frame of `scene` is the best one."""
    rng = np.random.default_rng((seed, 37))
    scene = with_boxes(another_day(scene, seed), how.boxes, rng)
    stations = scanner_positions(scene, num_stations, rng)
    rays = cast_rays(
        scene, stations, num_points, rng, lambda all_: _returned(scene, how, stations, all_, rng), _SURPLUS
    )
    exact = rays.ends(stations)
    drifts = draw_drifts(stations, how, rng)
    noise = rng.uniform(*how.noise_m, len(stations))[rays.station] * rng.normal(size=len(exact))
    measured = exact + rays.directions * noise[:, None]
    for number, drift in enumerate(drifts):
        own = rays.station == number
        measured[own] = measured[own] @ drift.rotation.T + drift.position
    is_labels = color_kind == "labels"
    colors = label_colors(scene, rays.hits) if is_labels else _colors(scene, how, stations, rays, exact, rng)
    cloud = PointCloud(measured.astype(np.float32), colors, num_points_read=len(exact))
    return ImperfectScan(Scan(cloud, rays.hits, exact, stations), scene, rays.station, drifts)


def draw_drifts(stations: NDArray[np.float64], how: Imperfections, rng: np.random.Generator) -> tuple[Pose, ...]:
    """Draw a drift per station (S, 3): turns about the middle of all stations, and shifts, both of zero mean."""
    shifts = _apart(rng, len(stations), how.drift_m)
    turns = np.radians(_apart(rng, len(stations), how.drift_deg))
    middle = stations.mean(0)
    rotations = [rotation_of(turn) for turn in turns]
    return tuple(Pose(turn, middle - turn @ middle + shift) for turn, shift in zip(rotations, shifts, strict=True))


def _apart(rng: np.random.Generator, count: int, apart: Range) -> NDArray[np.float64]:
    """Draw `count` vectors (count, 3) of zero mean with distances from each other within `apart`; one alone is zero.

    A dozen or more do not always fit: then some are closer.
    """
    if count < 2:
        return np.zeros((count, 3))
    for _ in range(_NUM_TRIES):
        drawn = rng.normal(size=(count, 3))
        distances = np.linalg.norm(drawn[:, None] - drawn, axis=-1)[np.triu_indices(count, 1)]
        scale = apart[1] * rng.uniform(0.6, 1) / distances.max()
        if distances.min() * scale >= apart[0]:
            break
    return np.asarray((drawn - drawn.mean(0)) * scale)


def _returned(
    scene: Scene, how: Imperfections, stations: NDArray[np.float64], rays: Rays, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the share in 0..1 (N,) of rays that return: fewer from afar and at glancing angles, none in blind wedges and holes."""
    surface, triangle, count = scene.surface, rays.hits.triangle, len(stations)
    points = np.where(rays.hits.found[:, None], rays.ends(stations), 0).astype(np.float32)
    label, blotch = surface.label[triangle], _blotches(points, rng)
    sine = np.abs((surface.normals[triangle] * rays.directions).sum(1))
    share = np.minimum(1, sine / np.sin(np.radians(how.glancing_deg))) ** 2
    share *= np.minimum(1, how.reach_m / np.maximum(rays.hits.distance, 0.1)) ** 2
    darkness = 1 - surface.atlas.mean_albedo.mean(1)[surface.texture[triangle]] / how.dark_albedo
    share[blotch < np.where(label == _SCREEN, _SHINY, darkness)] = 0
    start, width = rng.uniform(-np.pi, np.pi, count), np.radians(rng.uniform(*how.blind_deg, count))
    azimuth = np.arctan2(rays.directions[:, 1], rays.directions[:, 0])
    share[(azimuth - start[rays.station]) % (2 * np.pi) < width[rays.station]] = 0
    for center, radius_m, is_of_ceiling in _holes(scene, how, points[rays.hits.found], rng):
        # Blotches fray the rim.
        inside = ((points - center) ** 2).sum(1) < (radius_m * (0.75 + 0.5 * blotch)) ** 2
        share[inside & (label == _CEILING) if is_of_ceiling else inside] = 0
    return np.asarray(share, np.float32)


def _holes(
    scene: Scene, how: Imperfections, points: NDArray[np.float32], rng: np.random.Generator
) -> Iterator[tuple[NDArray[np.float32], float, bool]]:
    """Draw centre (3,) and radius in metres of every hole, and whether it is one of the ceiling alone; points (N, 3): of surfaces."""
    for room in scene.rooms:
        area_m2, gone = room.size_m[0] * room.size_m[1], rng.uniform(*how.ceiling_gone)
        for center in points[rng.integers(len(points), size=round(how.holes_per_m2 * area_m2))]:
            yield center, rng.uniform(*how.hole_m), False
        radius_m = float(np.sqrt(area_m2) / 5)
        for _ in range(round(gone * area_m2 / (np.pi * radius_m**2))):
            middle = rng.uniform((room.x0, room.y0), (room.x1, room.y1))
            yield np.array([*middle, room.height_m], np.float32), radius_m, True


def _blotches(points: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a smooth random field at points (N, 3), in 0..1, with spots of 0.1 to 0.4 m."""
    waves = rng.normal(size=(3, _NUM_WAVES)) * rng.uniform(5, 15, _NUM_WAVES)
    phases = rng.uniform(0, 2 * np.pi, _NUM_WAVES)
    field = np.sin(points @ waves.astype(np.float32) + phases.astype(np.float32)).mean(1)
    return np.asarray(np.clip(0.5 + field, 0, 1), np.float32)


def _colors(
    scene: Scene,
    how: Imperfections,
    stations: NDArray[np.float64],
    rays: Rays,
    exact: NDArray[np.float64],
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return colors (N, 3) of exact points (N, 3), as the camera of each station sees a place a little beside the point."""
    count, own = len(stations), rays.station
    shift = rng.normal(size=(count, 3))
    shift *= rng.uniform(*how.color_shift_m, (count, 1)) / np.linalg.norm(shift, axis=1, keepdims=True)
    normal = scene.surface.normals[rays.hits.triangle]
    along = shift[own] - normal * (shift[own] * normal).sum(1, keepdims=True)
    aim = exact + along - stations[own]
    aim /= np.linalg.norm(aim, axis=1, keepdims=True)
    seen = scene.surface.cast(stations[own], aim)
    color = shade(scene, seen, aim, rng.uniform(*how.blur_m, count)[own].astype(np.float32))
    # Six images around, each darker towards its corners.
    across = (np.arctan2(aim[:, 1], aim[:, 0]) / np.pi * 3) % 1 * 2 - 1
    lost = rng.uniform(*how.vignetting, count)[own] * (across**2 + aim[:, 2] ** 2) / 2
    red, blue = rng.uniform(*how.white_balance, (2, count))
    gain = rng.uniform(*how.exposure, (count, 1)) * np.stack((red, np.ones(count), blue), 1)
    color = color * gain[own] * (1 - lost)[:, None] + rng.normal(0, how.color_noise, color.shape)
    return np.asarray(np.clip(color, 0, 1) * 255 + 0.5, np.uint8)


def with_boxes(scene: Scene, share: float, rng: np.random.Generator) -> Scene:
    """Return the scene with about `share` of its standing furniture as boxes under the same keys; lamps keep their shape."""
    return replace(scene, objects=tuple(_boxed(thing) if rng.random() < share else thing for thing in scene.objects))


def _boxed(thing: SceneObject) -> SceneObject:
    """Return the thing with its main piece as a box; what is fixed, hangs or shines stays."""
    item = thing.item
    if item is None or not thing.movable or item.anchor not in _STANDING or item.lights:
        return thing
    main, *others = item.pieces
    own, there = (np.concatenate([part.vertices for part in piece.parts]) for piece in (main, thing.pieces[0]))
    # The turn about z that takes the item to its place (Procrustes in the plane).
    flat, turned = ((points - points.mean(0))[:, :2] @ (1, 1j) for points in (own, there))
    yaw = float(np.angle((flat.conj() * turned).sum()))
    x, y, z = there.mean(0) - about_z(yaw) @ own.mean(0)
    low, high = own.min(0), own.max(0)
    parts = box(high - low, plain(_mean_color(main)), (*((low + high) / 2)[:2], low[2]))
    proxy = replace(item, pieces=(Piece(main.label, tuple(parts)), *others))
    return placed(proxy, thing.key, yaw, (x, y, z), thing.footprint, thing.room)


def _mean_color(piece: Piece) -> NDArray[np.float64]:
    """Return the mean sRGB color (3,) in 0..1 of a piece, weighted by area."""
    area, albedo = [], []
    for part in piece.parts:
        a, b, c = part.vertices[part.triangles].swapaxes(0, 1)
        area.append(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        albedo.append(part.texture.mean_albedo)
    mean: NDArray[np.float64] = np.average(albedo, axis=0, weights=area) ** (1 / 2.2)
    return mean
