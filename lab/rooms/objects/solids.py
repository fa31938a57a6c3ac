"""Surfaces of which everything is built: quads, boxes, cylinders and ellipsoids with texture coordinates in metres."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.materials.texture import Texture

Vector = Sequence[float] | NDArray[np.floating]

# Light is stored at vertices, so large faces are cut into a grid about this fine.
_GRID_STEP_M = 0.22


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of surface with one texture; normals point out of the solid.

    vertices: (V, 3) float64 metres. triangles: (T, 3) int64, counter-clockwise from outside.
    uv_m: (V, 2) float64 metres.
    glow: radiance emitted per unit of texture; zero for surfaces that only reflect.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    uv_m: NDArray[np.float64]
    texture: Texture
    glow: float = 0.0


def quad(
    corner: Vector,
    edge_u: Vector,
    edge_v: Vector,
    texture: Texture,
    *,
    uv_start: tuple[float, float] = (0.0, 0.0),
    glow: float = 0.0,
    step_m: float = _GRID_STEP_M,
) -> Part:
    """Return a rectangle `corner + a edge_u + b edge_v`.

    Its normal is edge_u x edge_v; texture coordinates run in metres from `uv_start`.
    """
    origin, u_edge, v_edge = (np.asarray(vector, np.float64) for vector in (corner, edge_u, edge_v))
    u_length, v_length = float(np.linalg.norm(u_edge)), float(np.linalg.norm(v_edge))
    columns, rows = (max(1, int(np.ceil(length / step_m))) for length in (u_length, v_length))
    b, a = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    a, b = a.reshape(-1, 1), b.reshape(-1, 1)
    uv = np.concatenate((a * u_length + uv_start[0], b * v_length + uv_start[1]), axis=1)
    return Part(origin + a * u_edge + b * v_edge, _grid_triangles(rows, columns), uv, texture, glow)


def box(
    size: Vector,
    texture: Texture | Mapping[str, Texture],
    center: Vector = (0.0, 0.0, 0.0),
    *,
    skip: Iterable[str] = (),
    step_m: float = _GRID_STEP_M,
) -> list[Part]:
    """Return a box whose bottom centre is `center`.

    texture: one for all faces, or by face name: front (+y), back (−y), right (+x), left (−x), top, bottom, and "sides"
    for those not named.
    """
    w, d, h = size
    x0, y0, z0 = center[0] - w / 2, center[1] - d / 2, center[2]
    x1, y1, z1 = x0 + w, y0 + d, z0 + h
    faces = {
        "front": ((x1, y1, z0), (-w, 0, 0), (0, 0, h)),
        "back": ((x0, y0, z0), (w, 0, 0), (0, 0, h)),
        "right": ((x1, y0, z0), (0, d, 0), (0, 0, h)),
        "left": ((x0, y1, z0), (0, -d, 0), (0, 0, h)),
        "top": ((x0, y0, z1), (w, 0, 0), (0, d, 0)),
        "bottom": ((x0, y1, z0), (w, 0, 0), (0, -d, 0)),
    }
    skipped = set(skip)
    parts = []
    for name, (corner, edge_u, edge_v) in faces.items():
        if name not in skipped:
            chosen = texture if isinstance(texture, Texture) else texture.get(name, texture["sides"])
            parts.append(quad(corner, edge_u, edge_v, chosen, step_m=step_m))
    return parts


def cylinder(
    radius: float,
    height: float,
    texture: Texture,
    center: Vector = (0.0, 0.0, 0.0),
    *,
    top_radius: float | None = None,
    num_sides: int = 14,
    glow: float = 0.0,
) -> list[Part]:
    """Return an upright cylinder or truncated cone with caps; `center` is the centre of its bottom."""
    upper = radius if top_radius is None else top_radius
    angle = np.linspace(0, 2 * np.pi, num_sides + 1)
    circle = np.stack((np.cos(angle), np.sin(angle), np.zeros_like(angle)), axis=1)
    base = np.asarray(center, np.float64)
    lift = np.array([0.0, 0.0, height])
    wall = np.concatenate((base + circle * radius, base + lift + circle * upper))
    around = angle * max(radius, upper)
    uv = np.concatenate((np.stack((around, np.zeros_like(around)), 1), np.stack((around, around * 0 + height), 1)))
    parts = [Part(wall, _grid_triangles(1, num_sides), uv, texture, glow)]
    for sign, rim, at in ((1, upper, base + lift), (-1, radius, base)):
        if rim > 1e-3:
            parts.append(_disc(at, circle[:-1] * rim, sign, texture, glow))
    return parts


def ellipsoid(radii: Sequence[float], texture: Texture, center: Vector) -> list[Part]:
    """Return an ellipsoid around `center`."""
    rows, columns = 8, 12
    polar, around = np.meshgrid(np.linspace(np.pi, 0, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    unit = np.stack((np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)), -1).reshape(-1, 3)
    scale = np.asarray(radii, np.float64)
    uv = np.stack((around * scale[:2].mean(), (np.pi - polar) * scale.mean()), -1).reshape(-1, 2)
    return [Part(np.asarray(center) + unit * scale, _grid_triangles(rows, columns), uv, texture)]


def moved(parts: Iterable[Part], yaw: float = 0.0, offset: Vector = (0.0, 0.0, 0.0)) -> list[Part]:
    """Return the parts turned by `yaw` radians about z, then shifted by `offset`."""
    turn = about_z(yaw)
    return [replace(part, vertices=part.vertices @ turn.T + np.asarray(offset, np.float64)) for part in parts]


def about_z(yaw: float) -> NDArray[np.float64]:
    """Return the rotation (3, 3) by `yaw` radians about z."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])


def _disc(center: NDArray[np.float64], rim: NDArray[np.float64], sign: int, texture: Texture, glow: float) -> Part:
    count = len(rim)
    vertices = np.concatenate((center[None], center + rim))
    ring = np.arange(count)
    triangles = np.stack((ring * 0, ring + 1, (ring + 1) % count + 1), axis=1)[:, :: 1 if sign > 0 else -1]
    return Part(vertices, triangles, vertices[:, :2] - center[:2], texture, glow)


def _grid_triangles(rows: int, columns: int) -> NDArray[np.int64]:
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    corner = (row * (columns + 1) + column).reshape(-1)
    above = corner + columns + 1
    return np.concatenate(
        (np.stack((corner, corner + 1, above + 1), axis=1), np.stack((corner, above + 1, above), axis=1))
    )
