"""Work that needs numpy, Pillow or pye57, which commands do not load: each piece runs in a process of its own.

A crash there, as on a damaged E57 file, fails that piece of work and nothing else.
"""

import json
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import typer

from panoloc.core.options import ExportFormat
from panoloc.service.batches.overview import photo_of, placement_document
from panoloc.service.cli.placing.place_folder import PlaceFolder

CONTACT_SHEET = "contact-sheet.jpg"
_E57_HEAD = b"ASTM-E57"


class ProcessFailedError(Exception):
    """A process ended with an error; the message is the last line that it printed."""


def write_export(tour: dict[str, Any], name: ExportFormat, target: Path) -> None:
    """Write one format into the folder `target`. Raises ProcessFailedError where the format cannot hold the photos."""
    try:
        _run("panoloc.core.exports", name, str(target), document=tour)
    except ProcessFailedError:
        with suppress(OSError):  # a refused format leaves an empty folder
            target.rmdir()
        raise


def draw_overviews(placed: PlaceFolder) -> tuple[list[Path], list[str]]:
    """Draw `contact-sheet.jpg` and `plan.png`, or one `plan-MAP.png` per map. Returns the pictures, and why others failed."""
    pictures, failures, maps = list[Path](), list[str](), placed.maps()
    shown: list[str | None] = [*maps] or [None]
    for map_id in shown:
        names = [CONTACT_SHEET] if map_id == shown[0] else []
        if map_id is not None:
            names.append("plan.png" if len(maps) == 1 else f"plan-{map_id}.png")
        photos = [photo_of(name, placed.result(name), map_id, placed.photo(name)) for name in placed.names()]
        document = placement_document(map_id, None if map_id is None else placed.points(map_id), photos)
        targets = [placed.folder / name for name in names]
        try:
            _run("panoloc.core.exports.overview", *map(str, targets), document=document)
            pictures += targets
        except ProcessFailedError as error:
            failures.append(f"{', '.join(names)}: cannot be drawn ({error})")
    return pictures, failures


def folder_of_photos(given: Path, out: Path) -> Path:
    """Return a folder itself, or `OUT/images` with the images of an E57 file. Raises typer.BadParameter and OSError."""
    if given.is_dir():
        return given
    with given.open("rb") as stream:
        if stream.read(len(_E57_HEAD)) != _E57_HEAD:
            raise _wrong_folder(f"expected a folder of photos or an E57 file, got {given}, which is neither")
    folder = out / "images"
    try:
        found = json.loads(_run("panoloc.core.scan.e57", str(given), str(folder)))
    except ProcessFailedError as error:
        raise _wrong_folder(str(error)) from error
    if not found["num_images"]:
        raise _wrong_folder(
            f"expected an E57 file with panoramas or pinhole images, got {given} with none "
            f"({found['num_others']} others); export the images with the scanner's software, and pass their folder"
        )
    return folder


def _wrong_folder(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="FOLDER")


def _run(module: str, *arguments: str, document: dict[str, Any] | None = None) -> str:
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
