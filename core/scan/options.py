"""What the caller says about a scan that the file itself does not."""

from dataclasses import dataclass
from typing import Literal, get_args

from core.errors import OptionsError

Unit = Literal["m", "cm", "mm", "ft"]
UpAxis = Literal["z", "y"]
ColorKind = Literal["rgb", "labels"]

METRES_PER_UNIT: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048}


@dataclass(frozen=True)
class ScanOptions:
    """How to read a scan.

    unit: length unit of the file's coordinates. up_axis: the axis that points up in the file.
    max_points: how many points may remain after voxel thinning.
    max_points_read: a file with more points than this is refused before anything is allocated.
    color_kind: "labels" are colour codes of classes and never averaged.
    format: file extension ("ply", ".laz"), used when the path has none.

    Raises OptionsError for a value out of its range.
    """

    unit: Unit = "m"
    up_axis: UpAxis = "z"
    max_points: int = 500_000
    max_points_read: int = 200_000_000
    color_kind: ColorKind = "rgb"
    format: str | None = None

    def __post_init__(self) -> None:
        _check_choice("unit", self.unit, get_args(Unit))
        _check_choice("up_axis", self.up_axis, get_args(UpAxis))
        _check_choice("color_kind", self.color_kind, get_args(ColorKind))
        for name, value in (("max_points", self.max_points), ("max_points_read", self.max_points_read)):
            if value < 1:
                raise OptionsError(f"{name} must be at least 1, got {value}.")


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise OptionsError(f"{name} must be one of {', '.join(choices)}; got {value!r}.")
