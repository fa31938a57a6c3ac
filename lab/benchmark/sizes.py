"""How large everything is that the benchmark measures: in full, and quick to see that it runs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Sizes:
    """Sizes of one run.

    points: of the scan, before thinning. starts: about how many, reached by their spacing. width: pixels of the panorama.
    repeats: of each figure, after warm_ups that do not count; registrations and queries over maps take a third of them.
    candidates: that the search hands on, None for the configuration's.
    map_counts: maps searched by one query; num_rooms: how many of them differ, with room_points and room_starts each, and room_width
    of the panorama. num_panoramas: that queries over HTTP take in turn; clients: how many send at the same time; queries: they send in
    all; idle_s: seconds after which a service counts as idle. camera_rooms: furnished rooms that every camera photographs.
    """

    points: int = 1_000_000
    starts: int = 400
    width: int = 2048
    repeats: int = 9
    warm_ups: int = 2  # the first call allocates, the second finds everything in place
    candidates: int | None = None
    map_counts: tuple[int, ...] = (1, 10, 100)
    num_rooms: int = 8
    room_points: int = 50_000
    room_starts: int = 100
    room_width: int = 1024
    num_panoramas: int = 4
    clients: tuple[int, ...] = (1, 4, 16)
    queries: int = 48
    idle_s: float = 3.0
    camera_rooms: int = 4
    camera_points: int = 200_000

    @property
    def few_repeats(self) -> int:
        """Return the repetitions of what takes long."""
        return max(1, self.repeats // 3)


FULL = Sizes()
QUICK = Sizes(
    points=6_000,
    starts=12,
    width=256,
    repeats=2,
    warm_ups=0,
    candidates=4,
    map_counts=(1, 2, 4),
    num_rooms=2,
    room_points=3_000,
    room_starts=6,
    room_width=256,
    num_panoramas=2,
    clients=(1, 2),
    queries=4,
    idle_s=1.0,
    camera_rooms=1,
    camera_points=4_000,
)
