"""Exports of a placed folder, written by `python -m core.exports`, because that needs numpy, which commands do not load."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, get_args

import typer

from core.options import FORMATS_ON_EARTH, ExportFormat
from service.client import JsonObject

FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)


class Placed(Protocol):
    """Photos with their poses, wherever they are kept."""

    def maps(self) -> list[str]:
        """Return the maps in which photos were placed."""

    def tour(self, map_id: str, include_ambiguous: bool, survey: Path | None = None) -> dict[str, Any]:
        """Return the photos of a map as `core.exports` reads them."""


class ExportError(ValueError):
    """A format cannot hold the photos; the message says why and what to do."""


@dataclass(frozen=True)
class Written:
    """What came of exports. folders: also single files. refusals: of those that are not there, each with the reason."""

    folders: list[Path] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)

    def add(self, other: "Written") -> None:
        """Take over what came of others."""
        self.folders.extend(other.folders)
        self.refusals.extend(other.refusals)


def formats_of(given: str | None) -> list[ExportFormat]:
    """Return the formats of a list with commas, each once. Raises typer.BadParameter."""
    wanted = [name.strip() for name in (given or "").split(",") if name.strip()]
    unknown = [name for name in wanted if name not in FORMATS]
    if unknown:
        raise typer.BadParameter(f"expected some of {', '.join(FORMATS)}, got {unknown[0]!r}", param_hint="--export")
    return [name for name in FORMATS if name in wanted]


def why_not_on_earth(formats: list[ExportFormat], maps: Iterable[JsonObject]) -> str | None:
    """Return why formats cannot be written of any of the maps, None: nothing is known against it.

    maps: as the service describes them; asked for only where a format depends on it.
    """
    on_earth = [name for name in formats if name in FORMATS_ON_EARTH]
    known = list(maps) if on_earth else []
    if not known or any(each.get("georeference") or each.get("coordinate_system") for each in known):
        return None
    return (
        f"{', '.join(on_earth)}: expected a map with a georeference or a coordinate system, because such a format has places on Earth, got "
        "none with one; set it with PATCH /maps/{id}, or leave the format out and write it later with `panoloc export`"
    )


def write_exports(
    placed: Placed, formats: list[ExportFormat], include_ambiguous: bool, out: Path, survey: Path | None = None
) -> Written:
    """Write each format into a folder of its own below `out`, and below that of its map where there are several.

    A format that cannot hold the photos is named with the reason and keeps no other from being written. survey: the scan itself, an
    E57 in the frame of the map. Raises PlaceFolderError.
    """
    written = Written()
    maps = placed.maps()
    for map_id in maps:
        tour = placed.tour(map_id, include_ambiguous, survey)
        for name in formats:
            target = out / name if len(maps) == 1 else out / map_id / name
            try:
                _export(tour, name, target)
                written.folders.append(target)
            except ExportError as error:
                written.refusals.append(str(error))
    return written


def _export(tour: dict[str, object], name: ExportFormat, target: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        document = Path(folder) / "tour.json"
        document.write_text(json.dumps(tour), encoding="utf-8")
        command = [sys.executable, "-m", "core.exports", str(document), name, str(target)]
        process = subprocess.run(command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, check=False)
    if process.returncode != 0:
        with suppress(OSError):  # what a refused format leaves is an empty folder
            target.rmdir()
        raise ExportError((process.stderr.strip().splitlines() or [f"{name}: the export failed without a word"])[-1])
