"""From a specification to a scene."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from panoloc.core.errors import OptionsError
from panoloc.lab.rooms.materials.style import STYLES, style_of
from panoloc.lab.rooms.scenes.flat_scene import furnished_flat
from panoloc.lab.rooms.scenes.room_scene import bare_room, furnished_room
from panoloc.lab.rooms.scenes.scene import Scene
from panoloc.lab.rooms.scenes.street_scene import street
from panoloc.lab.rooms.scenes.twin_scene import mirrored_rooms, nearly_twin_rooms, repeated_rooms, twin_rooms

SceneKind = Literal["room", "flat", "bare", "street", "twins", "twins_like", "mirrored", "repeated"]
_ALIKE = {
    "twins": twin_rooms,
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
    kinds = {"room": 0, "flat": 1, "bare": 2, "street": 3, "twins": 4, "twins_like": 5, "mirrored": 6, "repeated": 7}
    if spec.kind not in kinds:
        raise OptionsError(f"kind: expected one of {', '.join(kinds)}, got {spec.kind!r}")
    rng = np.random.default_rng((spec.seed, kinds[spec.kind]))
    drawn = FAMILIES[rng.integers(len(FAMILIES))]
    style = style_of(spec.family or drawn)
    if spec.kind == "flat":
        return furnished_flat(rng, style)
    if spec.kind in _ALIKE:
        return _ALIKE[spec.kind](rng, style, spec.area_m2)
    if spec.kind == "street":
        return street(rng, style)
    if spec.kind == "bare":
        return bare_room(rng, style, spec.area_m2)
    return furnished_room(rng, style, spec.area_m2)
