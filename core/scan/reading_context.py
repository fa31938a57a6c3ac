"""What every reader gets and gives: the file with its limits, and chunks of raw points."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.options import METRES_PER_UNIT, ScanOptions, Unit, UpAxis
from panoloc.core.scan.point_cloud import Diagnostic

CHUNK_ROWS = 1 << 20


@dataclass(frozen=True)
class RawChunk:
    """A bounded piece of a scan, in the file's own unit, axes and colour range.

    positions: (n, 3) float64. colors: (n, 3) uint8, uint16 or float64, the same type in every chunk of a file; they
    stay raw because their range is only known at the end. fraction: how much of the file is read, 0..1.
    """

    positions: NDArray[np.float64]
    colors: NDArray[Any]
    fraction: float


@dataclass
class ReadingContext:
    """One file being read: where it is, what is allowed, and what was noticed.

    folder: below which the files lie that it may refer to, such as textures; None for a file that came alone.
    coordinate_system: of its coordinates, as "EPSG:25832" or WKT, where the file says so. unit, height_unit, up_axis: likewise.
    turned_from: the up axis of every file of this format, where the reader turns it to z. is_part: of a whole that is judged together.
    """

    path: Path
    options: ScanOptions
    size_bytes: int
    diagnostics: list[Diagnostic] = field(default_factory=list)
    folder: Path | None = None
    coordinate_system: str | None = None
    unit: Unit | None = None
    height_unit: Unit | None = None
    up_axis: UpAxis | None = None
    turned_from: UpAxis | None = None
    is_part: bool = False

    @property
    def sampled_metres(self) -> float:
        """Return the length of a unit, metres, as far as it is known before the scan is read: for choosing how many points a mesh gets."""
        return 1.0 if self.options.unit == "auto" else METRES_PER_UNIT[self.options.unit]

    def note(self, code: str, message: str, severity: str = "info") -> None:
        """Record something that the operator should know."""
        self.diagnostics.append(Diagnostic(code, severity, message))

    def ask(self, code: str, message: str, text: str, choices: list[dict[str, Any]]) -> None:
        """Record a doubt with a question that ends it; see `Diagnostic`."""
        self.diagnostics.append(Diagnostic(code, "warning", message, {"text": text, "choices": choices}))

    def check_point_count(self, num_points: int) -> None:
        """Refuse a count that no file may announce, before anything is allocated for it."""
        if num_points == 0:
            raise ScanContentError("The file holds no points: its header announces 0. Export the scan again.")
        self.options.check_num_points(num_points)

    def note_scans(self, num_scans: int, num_colored: int, what: str) -> None:
        """Record how many scans of a file were merged, and how many were left out. what: such as "stations"."""
        if num_colored < num_scans:
            self.note(
                "scans_without_color",
                f"{num_scans - num_colored} of {num_scans} {what} in the file have no colour and were left out.",
                "warning",
            )
        if num_colored > 1:
            self.note("scans_merged", f"{num_colored} {what} were merged with their poses.")

    def companion(self, name: str, what: str) -> Path:
        """Return the file that the scan calls `name`, relative to itself. what: for the message, such as "texture".

        Raises ScanDamagedError for a name that leads out of the archive, ScanContentError where there is no such file.
        """
        relative = PurePosixPath(name.strip().replace("\\", "/"))
        if self.folder is None:
            raise ScanContentError(
                f"The scan refers to the {what} {name[:100]!r}, which was not uploaded with it. Put the scan and all "
                "files that it refers to into one zip and upload the zip."
            )
        root = self.folder.resolve()
        if "\x00" in name:
            raise _leads_out(name, what)
        found = (self.path.parent / relative).resolve()
        if relative.is_absolute() or not found.is_relative_to(root):
            # Programs write the paths of the machine that they ran on; the file itself often lies beside the scan.
            found = (self.path.parent / relative.name).resolve()
        if not found.is_relative_to(root):
            raise _leads_out(name, what)
        if not found.is_file():
            same = [
                path for path in found.parent.glob("*") if path.name.lower() == found.name.lower() and path.is_file()
            ]
            if len(same) != 1:
                raise ScanContentError(
                    f"The scan refers to the {what} {name[:100]!r}, but the zip holds no such file. Add it and upload it again."
                )
            found = same[0]
        return found


SAID = ("coordinate_system", "unit", "height_unit", "up_axis", "turned_from")
"""Fields of a context that readers set where the file says so."""

ScanReader = Callable[[ReadingContext], Iterator[RawChunk]]
"""Yields the points of a file of one format."""


def no_color_error(columns: str) -> ScanContentError:
    """Return the error for a scan without colour; `columns` says what the file has instead."""
    return ScanContentError(
        f"The scan has no colour (it has {columns}); localization compares colours. "
        "Export it with red, green and blue per point."
    )


def stack_columns(table: NDArray[np.void], names: Sequence[str], dtype: Any) -> NDArray[Any]:
    """Copy fields of a structured array into an (n, len(names)) array of `dtype`."""
    stacked = np.empty((len(table), len(names)), dtype)
    with np.errstate(invalid="ignore"):  # signalling NaNs of damaged files
        for axis, name in enumerate(names):
            stacked[:, axis] = table[name]
    return stacked


def _leads_out(name: str, what: str) -> ScanDamagedError:
    return ScanDamagedError(
        f"The scan refers to the {what} {name[:100]!r}, which is outside the upload. Refer only to files beside the "
        "scan."
    )
