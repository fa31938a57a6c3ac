"""Furniture as boxes, as simplified scans have it: a coarse proxy in the mean color of what stood there."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panoloc.lab.rooms.materials.texture import plain
from panoloc.lab.rooms.objects.objects import Piece, SceneObject, placed
from panoloc.lab.rooms.objects.solids import about_z, box
from panoloc.lab.rooms.scenes.scene import Scene

_STANDING = ("wall", "middle", "corner")


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
