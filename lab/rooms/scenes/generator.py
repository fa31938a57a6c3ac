"""From a specification to a scene."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from panoloc.core.errors import OptionsError
from panoloc.lab.rooms.materials.patterns import Rng
from panoloc.lab.rooms.materials.style import STYLES, Style
from panoloc.lab.rooms.scenes.flat_scene import furnished_flat
from panoloc.lab.rooms.scenes.room_scene import bare_room, furnished_room
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.street_scene import street
from panoloc.lab.rooms.scenes.twin_scene import equal_rooms, mirrored_rooms, nearly_twin_rooms, repeated_rooms

SceneKind = Literal["room", "flat", "bare", "street", "twins", "twins_like", "mirrored", "repeated"]
# The number of a kind seeds its scenes.
_BUILDERS: dict[str, Callable[[Rng, Style, float | None], Scene]] = {
    "room": furnished_room,
    "flat": lambda rng, style, _: furnished_flat(rng, style),
    "bare": bare_room,
    "street": lambda rng, style, _: street(rng, style),
    "twins": lambda rng, style, area_m2: equal_rooms(rng, style, area_m2, 2),
    "twins_like": nearly_twin_rooms,
    "mirrored": mirrored_rooms,
    "repeated": repeated_rooms,
}
FAMILIES: tuple[str, ...] = tuple(STYLES)


@dataclass(frozen=True)
class SceneSpec:
    """What scene to generate; the same specification always gives the same scene.

    family: one of `FAMILIES`, None to draw it from the seed. area_m2: floor area of a room, None to draw 9 to 55 m².
    """

    kind: SceneKind = "room"
    seed: int = 0
    family: str | None = None
    area_m2: float | None = None


def build_scene(spec: SceneSpec) -> Scene:
    """Build the scene of a specification; raises OptionsError for an unknown kind or family."""
    if spec.kind not in _BUILDERS:
        raise OptionsError(f"kind: expected one of {', '.join(_BUILDERS)}, got {spec.kind!r}")
    rng = np.random.default_rng((spec.seed, list(_BUILDERS).index(spec.kind)))
    drawn = FAMILIES[rng.integers(len(FAMILIES))]
    family = spec.family or drawn
    if family not in STYLES:
        raise OptionsError(f"family: expected one of {', '.join(STYLES)}, got {family!r}")
    return _BUILDERS[spec.kind](rng, STYLES[family], spec.area_m2)
