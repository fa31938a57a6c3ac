"""Traces a query, and counts its way through the rooms of the engine."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from types import FrameType

import numpy as np

from tests.structure.rooms import ROOT


@dataclass(frozen=True)
class Steps:
    """Rooms in the order in which they are entered: how many are entered for the first time, how often the next step is inside the same
    room, and how often it returns to a room that was left before."""

    rooms: int
    inside: int
    returns: int

    @classmethod
    def through(cls, rooms: Sequence[str]) -> "Steps":
        """Count the steps of a sequence of rooms."""
        seen: set[str] = set()
        entered = inside = returns = 0
        for number, room in enumerate(rooms):
            if number and room == rooms[number - 1]:
                inside += 1
            elif room in seen:
                returns += 1
            else:
                entered += 1
            seen.add(room)
        return cls(entered, inside, returns)


@dataclass(frozen=True)
class Called:
    """One call of a function in `core/`: the room that called (None from outside), the room and the line of the function."""

    caller: str | None
    room: str
    line: int


class Walk:
    """The calls of a query, in their order."""

    def __init__(self, calls: Sequence[Called]) -> None:
        self._calls = calls

    def of_functions(self) -> Steps:
        """Count the way of a reader who reads every function once, when it is first called."""
        return Steps.through([room for room, _ in dict.fromkeys((each.room, each.line) for each in self._calls)])

    def of_rooms(self, callers: Sequence[str] = ("core/*",)) -> Steps:
        """Count the way between rooms: each pair of a calling and a called room once, at its first call. callers: of these alone."""
        pairs = dict.fromkeys((each.caller, each.room) for each in self._calls if each.caller != each.room)
        return Steps.through(
            [room for caller, room in pairs if caller and any(fnmatch(caller, pattern) for pattern in callers)]
        )

    def of_pipeline(self) -> Steps:
        """Count the way between rooms of calls that the pipeline itself makes: `core/localizer.py` and `core/query/`."""
        return self.of_rooms(("core/localizer.py", "core/query/*"))


def traced(work: Callable[[], object]) -> Walk:
    """Run something and return the calls of functions in `core/`; comprehensions, lambdas and what a module runs when it is imported
    belong to the function around them."""
    calls: list[Called] = []
    rooms: dict[str, str | None] = {}

    def room_of(frame: FrameType) -> str | None:
        name = frame.f_code.co_filename
        if name not in rooms:
            path = Path(name).resolve()
            is_inside = path.is_relative_to(ROOT / "core")
            rooms[name] = str(path.relative_to(ROOT)) if is_inside else None
        return rooms[name]

    def note(frame: FrameType, event: str, _: object) -> None:
        if event != "call" or frame.f_code.co_name.startswith("<") or (room := room_of(frame)) is None:
            return
        caller = frame.f_back
        while caller is not None and room_of(caller) is None:
            caller = caller.f_back
        calls.append(Called(None if caller is None else room_of(caller), room, frame.f_code.co_firstlineno))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return Walk(calls)


def photo_query() -> Walk:
    """Trace the query of one photo of 75 degrees in a small painted room; some seconds."""
    from panoloc.core.camera.camera import Camera
    from panoloc.core.camera.rig import Rig
    from panoloc.core.localizer import Localizer
    from panoloc.core.map.map_builder import build_map_index
    from panoloc.core.options import IndexOptions
    from panoloc.lab.benchmark.painted_room import PaintedRoom
    from panoloc.lab.rooms import cut_photo

    room = PaintedRoom(0)
    index = build_map_index(room.scan(60_000), IndexOptions(spacing_m=0.6), device="cpu")
    lens = Camera.from_hfov("pinhole", 960, 720, 75.0)
    photo = cut_photo(room.panorama(room.pose(), 1024), lens, np.eye(3))
    localizer = Localizer(device="cpu")
    return traced(lambda: localizer.localize(Rig.of_photo(photo), [index]))
