"""How large everything is that the benchmark measures: in full, and quick to see that it runs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Sizes:
    """Sizes of one run.

    points: of the scan, before thinning. starts: about how many, reached by their spacing. width: pixels of the panorama.
    repeats: of each figure, after warm_ups that do not count; sweeps take a third of them. candidates: that the search hands on, None for
    the configuration's. search_rows: (starts, rotations, colour models).
    map_counts: maps searched by one query; num_rooms: how many of them differ, room_points each.
    sweep_*: values of one quantity while the others keep base_*. num_panoramas: that queries take in turn.
    camera_rooms: furnished rooms that are photographed by every camera.
    """

    points: int = 1_000_000
    starts: int = 400
    width: int = 2048
    repeats: int = 9
    warm_ups: int = 2  # the first call allocates, the second finds everything in place
    candidates: int | None = None
    search_rows: tuple[tuple[int, int, int], ...] = (
        (100, 2304, 1),
        (100, 2304, 4),
        (100, 23040, 1),
        (1000, 2304, 1),
        (400, 2304, 4),
    )
    map_counts: tuple[int, ...] = (1, 10, 100)
    num_rooms: int = 8
    room_points: int = 50_000
    room_starts: int = 100
    base_starts: int = 200
    base_points: int = 200_000
    base_width: int = 1024
    sweep_starts: tuple[int, ...] = (50, 100, 200, 400, 800)
    sweep_rotations: tuple[int, ...] = (576, 2304, 9216, 23040)
    sweep_points: tuple[int, ...] = (50_000, 100_000, 200_000, 500_000, 1_000_000)
    sweep_widths: tuple[int, ...] = (512, 1024, 2048, 4096)
    sweep_maps: tuple[int, ...] = (1, 2, 5, 10, 20)
    num_panoramas: int = 4
    camera_rooms: int = 4

    @property
    def sweep_repeats(self) -> int:
        """Return the repetitions of each figure of a sweep."""
        return max(1, self.repeats // 3)


FULL = Sizes()
QUICK = Sizes(
    points=6_000,
    starts=12,
    width=256,
    repeats=2,
    warm_ups=0,
    candidates=4,
    search_rows=((8, 576, 1), (8, 576, 2)),
    map_counts=(1, 2, 4),
    num_rooms=2,
    room_points=3_000,
    room_starts=6,
    base_starts=8,
    base_points=4_000,
    base_width=256,
    sweep_starts=(6, 12),
    sweep_rotations=(288, 576),
    sweep_points=(3_000, 6_000),
    sweep_widths=(256, 512),
    sweep_maps=(1, 2),
    num_panoramas=2,
    camera_rooms=1,
)
