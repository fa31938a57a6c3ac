"""The building around the furniture: floor, ceiling, walls with openings, skirting, doors and windows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.materials import artwork, patterns
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import Style, floor_texture, pick, wall_texture
from panoloc.lab.rooms.materials.texture import Texture, plain
from panoloc.lab.rooms.objects.objects import Light, SceneObject, fixed
from panoloc.lab.rooms.objects.solids import Part, quad

_CASING_M = 0.01


@dataclass(frozen=True)
class Opening:
    """A hole in a wall. start_m: along the wall; sill_m, top_m: above the floor; kind: "door", "window", "passage"."""

    wall: int
    start_m: float
    width_m: float
    sill_m: float
    top_m: float
    kind: str
    depth_m: float = 0.12


@dataclass(frozen=True)
class Room:
    """A rectangular room with its floor at z = 0; walls 0 to 3 lie at y0, x1, y1, x0."""

    x0: float
    y0: float
    x1: float
    y1: float
    height_m: float
    openings: tuple[Opening, ...] = ()

    @property
    def size_m(self) -> tuple[float, float]:
        """Return the extent along x and y."""
        return self.x1 - self.x0, self.y1 - self.y0

    def wall_length_m(self, wall: int) -> float:
        """Return the length of a wall."""
        return self.size_m[wall % 2]

    def wall_frame(self, wall: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return start, unit direction along, and inward normal of a wall, (3,) each; along x up = normal."""
        start = ((self.x1, self.y0), (self.x1, self.y1), (self.x0, self.y1), (self.x0, self.y0))[wall]
        along = ((-1, 0), (0, -1), (1, 0), (0, 1))[wall]
        inward = ((0, 1), (-1, 0), (0, -1), (1, 0))[wall]
        return np.array([*start, 0.0]), np.array([*along, 0.0]), np.array([*inward, 0.0])


def build_shell(rng: Rng, style: Style, room: Room, name: str, bare: bool = False) -> list[SceneObject]:
    """Build the fixed surfaces of a room; windows give light. bare: all walls and the floor in plain colors."""
    width, depth = room.size_m
    paint = _plain_floor if bare else floor_texture
    floor = quad((room.x0, room.y0, 0), (width, 0, 0), (0, depth, 0), paint(rng, style, room.size_m))
    white = patterns.plaster(rng, (0.93, 0.93, 0.91), (2.0, 2.0), 0.6)
    ceiling = quad((room.x0, room.y1, room.height_m), (width, 0, 0), (0, -depth, 0), white)
    color = pick(rng, style.walls)
    walls: list[Part] = []
    trim: list[Part] = []
    skirting = plain(pick(rng, (*style.woods, (0.93, 0.93, 0.92))))
    for wall in range(4):
        size = room.wall_length_m(wall), room.height_m
        texture = patterns.plaster(rng, color, size, 0.5) if bare else wall_texture(rng, style, color, size)
        walls += _wall_parts(room, wall, texture)
        trim += _skirting(room, wall, skirting)
    shell = [fixed(f"{name}/floor", "floor", [floor]), fixed(f"{name}/ceiling", "ceiling", [ceiling])]
    shell += [fixed(f"{name}/walls", "wall", walls), fixed(f"{name}/skirting", "trim", trim)]
    for number, opening in enumerate(room.openings):
        shell += _fill_opening(rng, style, room, opening, f"{name}/{opening.kind}{number}")
    return shell


def _plain_floor(rng: Rng, style: Style, size_m: tuple[float, float]) -> Texture:
    if rng.random() < 0.4:
        return patterns.planks(rng, pick(rng, style.woods), size_m)
    return patterns.concrete(rng, pick(rng, ((0.62, 0.58, 0.52), (0.50, 0.51, 0.53), (0.70, 0.66, 0.58))), size_m)


def _wall_parts(room: Room, wall: int, texture: Texture) -> list[Part]:
    """Cut the wall into strips around its openings."""
    start, along, _ = room.wall_frame(wall)
    holes = sorted((hole for hole in room.openings if hole.wall == wall), key=lambda hole: hole.start_m)
    rectangles, reached = [], 0.0
    for hole in holes:
        end = hole.start_m + hole.width_m
        rectangles += [(reached, hole.start_m, 0.0, room.height_m), (hole.start_m, end, 0.0, hole.sill_m)]
        rectangles.append((hole.start_m, end, hole.top_m, room.height_m))
        reached = end
    rectangles.append((reached, room.wall_length_m(wall), 0.0, room.height_m))
    return [
        quad(start + a * along + [0, 0, low], (b - a) * along, (0, 0, high - low), texture, uv_start=(a, low))
        for a, b, low, high in rectangles
        if b - a > 1e-6 and high - low > 1e-6
    ]


def _skirting(room: Room, wall: int, texture: Texture) -> list[Part]:
    start, along, inward = room.wall_frame(wall)
    gaps = [(h.start_m, h.start_m + h.width_m) for h in room.openings if h.wall == wall and h.sill_m < 0.05]
    edges = [0.0, *(edge for gap in sorted(gaps) for edge in gap), room.wall_length_m(wall)]
    parts = []
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a > 0.02:
            corner = start + a * along + 0.012 * inward
            parts.append(quad(corner, (b - a) * along, (0, 0, 0.08), texture, step_m=0.5))
            parts.append(quad(corner + np.array([0, 0, 0.08]), (b - a) * along, -0.012 * inward, texture, step_m=0.5))
    return parts


def _fill_opening(rng: Rng, style: Style, room: Room, hole: Opening, name: str) -> list[SceneObject]:
    start, along, inward = room.wall_frame(hole.wall)
    corner = start + hole.start_m * along + [0, 0, hole.sill_m]
    across, up = hole.width_m * along, np.array([0, 0, hole.top_m - hole.sill_m])
    back = -hole.depth_m * inward
    # The lining of a doorway reaches out to its casings, on one side for a door and on both for a passage.
    near = 0.0 if hole.kind == "window" else _CASING_M
    lining = back - (near + (_CASING_M if hole.kind == "passage" else 0.0)) * inward
    edge = corner + near * inward
    paint = plain((0.90, 0.89, 0.87))
    sill = quad(corner, across, back, paint)
    jamb = [sill, *_jamb(edge, across, up, lining, paint)] if hole.depth_m > 0 else []
    size = (hole.width_m, hole.top_m - hole.sill_m)
    if hole.kind == "passage":
        return [
            fixed(f"{name}/jamb", "door", jamb + _casing(corner, along, inward, size, plain(pick(rng, style.woods))))
        ]
    if hole.kind == "door":
        panel = quad(corner + back, across, up, door_panel(rng, style, size))
        casing = _casing(corner, along, inward, size, plain(pick(rng, style.woods)))
        return [fixed(name, "door", [*jamb, panel, *casing])]
    glass = quad(corner + back, across, up, artwork.window_view(rng, size), glow=1.0)
    steps = [(a, b) for a in (0.2, 0.5, 0.8) for b in (0.3, 0.7)]
    points = np.array([corner + back + 0.1 * inward + a * across + b * up for a, b in steps])
    light = Light(points, np.array([0.92, 0.97, 1.05]) * 2.4 * size[0] * size[1], inward)
    return [fixed(f"{name}/frame", "trim", jamb), fixed(f"{name}/glass", "window", [glass], (light,))]


def _jamb(
    corner: NDArray[np.float64],
    across: NDArray[np.float64],
    up: NDArray[np.float64],
    back: NDArray[np.float64],
    paint: Texture,
) -> list[Part]:
    """Return the two sides and the upper side of a hole, facing into it."""
    return [
        quad(corner + up + back, across, -back, paint),
        quad(corner, back, up, paint),
        quad(corner + across + back, -back, up, paint),
    ]


def _casing(
    corner: NDArray[np.float64],
    along: NDArray[np.float64],
    inward: NDArray[np.float64],
    size: Sequence[float],
    paint: Texture,
) -> list[Part]:
    """Return a flat frame around a hole on the room's side of the wall."""
    lift, wide = _CASING_M * inward, 0.07
    up = np.array([0.0, 0, 1])
    return [
        quad(corner + lift - wide * along, wide * along, up * size[1], paint),
        quad(corner + lift + size[0] * along, wide * along, up * size[1], paint),
        quad(corner + lift - wide * along + up * size[1], (size[0] + 2 * wide) * along, up * wide, paint),
    ]


def door_panel(rng: Rng, style: Style, size_m: tuple[float, float]) -> Texture:
    """Paint a door leaf with panels and a handle."""
    color = np.asarray(pick(rng, (*style.woods, (0.90, 0.90, 0.88))))
    pixels = patterns.wood(rng, color, size_m).pixels.copy()
    height, width = pixels.shape[:2]
    for low, high in ((0.08, 0.45), (0.52, 0.92)):
        top, bottom, left, right = int(low * height), int(high * height), int(0.16 * width), int(0.84 * width)
        pixels[top:bottom, left:right] = (pixels[top:bottom, left:right] * 0.86).astype(np.uint8)
        pixels[top : top + 3, left:right] = (pixels[top : top + 3, left:right] * 0.6).astype(np.uint8)
        pixels[top:bottom, left : left + 3] = (pixels[top:bottom, left : left + 3] * 0.7).astype(np.uint8)
    pixels[int(0.5 * height) : int(0.5 * height) + 5, int(0.85 * width) : int(0.95 * width)] = (150, 148, 140)
    return Texture(pixels, size_m)
