"""Day and night: the same scene with other shares of daylight and lamps, exposed anew as a camera does."""

from dataclasses import replace

from lab.rooms.objects.objects import Piece, SceneObject
from lab.rooms.scenes.lighting import Sky
from lab.rooms.scenes.scene import Scene

_DARK_GLASS = 0.02


def relit(scene: Scene, daylight: float = 1.0, lamps: float = 1.0) -> Scene:
    """Return the scene with daylight (windows, sun, sky) and lamps scaled; 1 keeps, 0 switches off.

    The same things stand at the same places, so nothing counts as changed. The exposure is chosen anew.
    """
    objects = tuple(_relit_object(thing, daylight, lamps) for thing in scene.objects)
    sky = Sky(_scaled(scene.sky.zenith, daylight), _scaled(scene.sky.horizon, daylight))
    return replace(scene, objects=objects, sky=sky, exposed_like=None)


def night(scene: Scene) -> Scene:
    """Return the scene with dark windows, lit by its lamps alone."""
    return relit(scene, daylight=0.0)


def day(scene: Scene) -> Scene:
    """Return the scene lit through its windows, with all lamps nearly off."""
    return relit(scene, daylight=1.5, lamps=0.05)


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
