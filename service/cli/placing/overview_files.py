"""Pictures of a placed folder, drawn by `python -m core.exports.overview`, because that needs numpy, which commands do not load."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from service.batches.overview import photo_of, placement_document
from service.cli.placing.export_folder import Written
from service.cli.placing.place_folder import PlaceFolder

CONTACT_SHEET = "contact-sheet.jpg"


def draw_overviews(placed: PlaceFolder) -> Written:
    """Draw `contact-sheet.jpg`, and `plan.png`, of several maps `plan-MAP.png` each. What cannot be drawn is named with the reason."""
    written, maps = Written(), placed.maps()
    names = placed.names()
    shown: list[str | None] = [*maps] or [None]
    for map_id in shown:
        pictures = [placed.folder / CONTACT_SHEET] if map_id == shown[0] else []
        if map_id is not None:
            pictures.append(placed.folder / ("plan.png" if len(maps) == 1 else f"plan-{map_id}.png"))
        photos = [photo_of(name, placed.result(name), map_id, placed.photo(name)) for name in names]
        points = None if map_id is None else placed.points(map_id)
        _draw(placement_document(map_id, points, photos), pictures, written)
    return written


def _draw(document: dict[str, object], pictures: list[Path], written: Written) -> None:
    with tempfile.TemporaryDirectory(prefix="panoloc-") as folder:
        path = Path(folder) / "placement.json"
        path.write_text(json.dumps(document), encoding="utf-8")
        command = [sys.executable, "-m", "core.exports.overview", str(path), *map(str, pictures)]
        process = subprocess.run(command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, check=False)
    if process.returncode == 0:
        written.folders.extend(pictures)
    else:
        said = (process.stderr.strip().splitlines() or ["it said nothing"])[-1]
        written.refusals.append(f"{', '.join(each.name for each in pictures)}: cannot be drawn ({said})")
