"""Placed photos as exports and pictures of them, each written by a process of its own.

That needs numpy, Pillow or pye57, which commands do not load. A crash there, as on a damaged E57 file, fails that piece
of work and nothing else.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import typer

from panoloc.core.options import ExportFormat
from panoloc.service.batches.tour import Photo, lacks_place, maps_of, overview_document, tour_document
from panoloc.service.client import JsonClient
from panoloc.service.jobs import MAX_SAMPLE_POINTS


@dataclass(frozen=True)
class Written:
    """What was written. paths: of folders and files. refusals: why others were not written."""

    paths: list[Path] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class PlacedPhotos:
    """Photos with their results. maps_folder: has map_x.json and map_x.ply of each map with photos in it.

    gone: names of photos that are missing now, each with what is said of it.
    """

    photos: Sequence[Photo]
    created_unix_s: float
    maps_folder: Path
    gone: Mapping[str, str] = field(default_factory=dict)

    def maps(self) -> list[str]:
        """Return the maps in which photos were placed."""
        return maps_of(photo.result for photo in self.photos)

    def fetch_maps(self, client: JsonClient, with_points: bool = True) -> None:
        """Store what exports need of the maps. with_points: False keeps the stored points. Raises ClientError."""
        for map_id in self.maps():
            file = self.maps_folder / f"{map_id}.json"
            replace_file(file, json.dumps(client.get_map(map_id)).encode())
            if with_points:
                points = client.fetch(f"/maps/{map_id}/points?format=ply&max_points={MAX_SAMPLE_POINTS}")
                replace_file(file.with_suffix(".ply"), points)

    def write_exports(
        self,
        formats: Sequence[ExportFormat],
        include_ambiguous: bool,
        out: Path,
        survey: Path | None = None,
        only_map: str | None = None,
    ) -> Written:
        """Write each format into a folder below `out`; with several maps, below a folder per map.

        A format that cannot hold the photos does not stop the others. survey: the scan itself, an E57 in the frame of
        the map. Raises typer.BadParameter if a map is not stored, or if no photo is in the only one that is wanted.
        """
        written, maps = Written(), self.maps()
        if only_map is not None and only_map not in maps:
            message = f"expected a map with photos in it, got {only_map}; the photos are in {', '.join(maps) or 'none'}"
            raise typer.BadParameter(message, param_hint="--map")
        maps = maps if only_map is None else [only_map]
        for map_id in maps:
            file = self.maps_folder / f"{map_id}.json"
            try:
                place = json.loads(file.read_text(encoding="utf-8"))
            except (FileNotFoundError, ValueError) as error:
                message = f"expected {map_id} in {file.parent}; let `panoloc place` finish"
                raise typer.BadParameter(message, param_hint="SOURCE") from error
            scan = file.with_suffix(".ply")
            tour = tour_document(
                map_id, include_ambiguous, self.photos, self.created_unix_s, place, scan, survey, self.gone
            )
            for name in formats:
                target = out / name if len(maps) == 1 else out / map_id / name
                is_new = not target.exists()
                try:
                    run_module("panoloc.core.exports", name, str(target), document=tour)
                    written.paths.append(target)
                except ProcessFailedError as error:
                    if is_new:  # half of an export looks like a whole one
                        shutil.rmtree(target, ignore_errors=True)
                    how = f"; {how_to_place(map_id)} sets one" if lacks_place(name, place) else ""
                    written.refusals.append(f"{error}{how}")
        return written

    def draw_overviews(self, out: Path) -> Written:
        """Draw `contact-sheet.jpg` and `plan.png`, or one `plan-MAP.png` per map."""
        written, maps = Written(), self.maps()
        drawn = [("plan.png" if len(maps) == 1 else f"plan-{map_id}.png", map_id) for map_id in maps]
        for number, (plan, map_id) in enumerate(drawn or [(None, None)]):
            names = (["contact-sheet.jpg"] if number == 0 else []) + ([plan] if plan else [])
            points = self.maps_folder / f"{map_id}.ply"
            document = overview_document(map_id, points if points.exists() else None, self.photos)
            targets = [out / name for name in names]
            try:
                run_module("panoloc.core.exports.overview", *map(str, targets), document=document)
                written.paths.extend(targets)
            except ProcessFailedError as error:
                written.refusals.append(f"{', '.join(names)}: cannot be drawn ({error})")
        return written


def what_was_written(path: Path) -> str:
    """Return a path, and of the folder of an export how many photos it holds and leaves out."""
    try:
        found = json.loads((path / "export.json").read_text(encoding="utf-8"))
    except OSError:  # a picture
        return str(path)
    left_out = f", left out: {len(found['left_out'])}, see unplaced.txt there" if found["left_out"] else ""
    return f"{path} (photos: {found['num_photos']}{left_out})"


def how_to_place(map_id: str) -> str:
    """Return the commands that give a map a place on Earth."""
    return f"`panoloc maps set {map_id} --coordinate-system` or `panoloc maps control-points {map_id} --apply`"


class ProcessFailedError(Exception):
    """A process ended with an error; the message is the last line that it printed."""


def run_module(module: str, *arguments: str, document: dict[str, Any] | None = None) -> str:
    """Run `python -m MODULE [DOCUMENT] ARGUMENT...` and return what it prints. Raises ProcessFailedError.

    document: given as a JSON file, the first argument.
    """
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        if document is not None:
            file = Path(folder) / "document.json"
            file.write_text(json.dumps(document), encoding="utf-8")
            arguments = (str(file), *arguments)
        command = [sys.executable, "-P", "-m", module, *arguments]
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, text=True, check=False)
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        raise ProcessFailedError(lines[-1] if lines else f"{module} ended with exit code {done.returncode}")
    return done.stdout


def replace_file(file: Path, data: bytes) -> None:
    """Write a file atomically: a kill leaves the old one or the new one. Makes its folder."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(f".{file.name}.tmp")
    temporary.write_bytes(data)
    temporary.replace(file)
