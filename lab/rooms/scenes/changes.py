"""What happens to a scene between the scan and the photo: things move, vanish and appear, carpets go, and night falls."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from panoloc.lab.rooms.objects.furnishing import Furnisher
from panoloc.lab.rooms.objects.objects import Item, Piece, SceneObject
from panoloc.lab.rooms.objects.solids import moved
from panoloc.lab.rooms.scenes.lighting import Sky
from panoloc.lab.rooms.scenes.scene import Scene, unique_objects
from panoloc.lab.rooms.scenes.street_scene import StreetDresser

# Of the changed things, these shares move and vanish; the rest is replaced by something else.
_MOVED, _REMOVED = 0.4, 0.35
_ADDED = 0.6
_DARK_GLASS = 0.02


def change_scene(scene: Scene, fraction: float = 0.6, seed: int = 0) -> Scene:
    """Return the scene with about `fraction` of its movable things changed, new ones added, doors swung and all rugs gone.

    The building, its lamps and the exposure stay; light is baked again, so shadows follow the furniture.
    """
    rng = np.random.default_rng((seed, 3))
    kept: list[SceneObject] = []
    moving: list[tuple[int, Item]] = []
    num_changed = 0
    for thing in scene.objects:
        if thing.hinge and rng.random() < fraction:
            kept.append(_swung(thing, rng.uniform(0.3, 0.9)))
        elif thing.item is None or not thing.movable:
            kept.append(thing)
        elif thing.item.anchor == "floor":
            num_changed += 1
        elif rng.random() >= fraction:
            kept.append(thing)
        else:
            num_changed += 1
            if rng.random() < _MOVED / (_MOVED + _REMOVED):
                moving.append((thing.room, thing.item))
    num_new = round(num_changed * _ADDED)
    added = _add(scene, kept, moving, num_new, rng)
    return replace(scene, objects=unique_objects((*kept, *added)), exposed_like=scene)


def night(scene: Scene) -> Scene:
    """Return the scene with dark windows, lit by its lamps alone."""
    return _relit(scene, daylight=0.0, lamps=1.0)


def day(scene: Scene) -> Scene:
    """Return the scene lit through its windows, with all lamps nearly off."""
    return _relit(scene, daylight=1.5, lamps=0.05)


def another_day(scene: Scene, seed: int) -> Scene:
    """Return the scene in the light of another day, drawn from dusk with lamps to sun without."""
    rng = np.random.default_rng((seed, 5))
    return _relit(scene, daylight=rng.uniform(0.3, 1.4), lamps=rng.uniform(0.1, 1.0))


def _swung(leaf: SceneObject, angle: float) -> SceneObject:
    """Return a door leaf partly closed, by `angle` radians."""
    assert leaf.hinge is not None
    hinge = np.array([*leaf.hinge, 0.0])
    pieces = []
    for piece in leaf.pieces:
        at_origin = moved(piece.parts, 0.0, -hinge)
        pieces.append(replace(piece, parts=tuple(moved(at_origin, angle, hinge))))
    return replace(leaf, key=f"{leaf.key}~{angle:.3f}", pieces=tuple(pieces))


def _add(
    scene: Scene,
    kept: Sequence[SceneObject],
    moving: Sequence[tuple[int, Item]],
    num_new: int,
    rng: np.random.Generator,
) -> list[SceneObject]:
    added: list[SceneObject] = []
    areas = np.array([room.size_m[0] * room.size_m[1] for room in scene.rooms])
    new_per_room = rng.multinomial(num_new, areas / areas.sum())
    for number, room in enumerate(scene.rooms):
        here = [thing for thing in kept if thing.room == number]
        furnisher = StreetDresser(rng, here) if scene.outdoor else Furnisher(rng, scene.style, room, number, here)
        for where, item in moving:
            if where == number:
                furnisher.add_again(item)
        for _ in range(new_per_room[number]):
            furnisher.add_something()
        added += furnisher.objects
    return added


def _relit(scene: Scene, daylight: float, lamps: float) -> Scene:
    """Return the scene with daylight (windows, sun, sky) and lamps scaled; 1 keeps, 0 switches off.

    The same things stand at the same places, so nothing counts as changed. The exposure is chosen anew.
    """
    objects = tuple(_relit_object(thing, daylight, lamps) for thing in scene.objects)
    sky = Sky(_scaled(scene.sky.zenith, daylight), _scaled(scene.sky.horizon, daylight))
    return replace(scene, objects=objects, sky=sky, exposed_like=None)


def _scaled(color: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    red, green, blue = color
    return red * factor, green * factor, blue * factor


def _relit_object(thing: SceneObject, daylight: float, lamps: float) -> SceneObject:
    factor = daylight if any(piece.label in ("window", "road") for piece in thing.pieces) else lamps
    if not thing.lights and all(part.glow == 0 for piece in thing.pieces for part in piece.parts):
        return thing
    lights = tuple(replace(light, power=light.power * factor) for light in thing.lights if factor > 0)
    return replace(thing, pieces=tuple(_relit_piece(piece, factor) for piece in thing.pieces), lights=lights)


def _relit_piece(piece: Piece, factor: float) -> Piece:
    def glow(amount: float) -> float:
        """Return the glow (0: none) scaled, yet no darker than dark glass is and no brighter than it was."""
        return min(amount, max(_DARK_GLASS, amount * factor)) if amount > 0 else 0.0

    return replace(piece, parts=tuple(replace(part, glow=glow(part.glow)) for part in piece.parts))
