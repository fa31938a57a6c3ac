"""The images of an E57 file as a folder of photos, taken out by `python -m core.scan.e57`, because that needs pye57."""

import json
import subprocess
import sys
from pathlib import Path

_HEAD = b"ASTM-E57"


class SurveyError(ValueError):
    """A file is no E57, or has no images; the message says what to do."""


def folder_of_photos(given: Path, out: Path) -> Path:
    """Return a folder itself, or `OUT/images` with the images of an E57 file. Raises SurveyError and OSError."""
    if given.is_dir():
        return given
    with given.open("rb") as stream:
        if stream.read(len(_HEAD)) != _HEAD:
            raise SurveyError(f"expected a folder of photos or an E57 file, got {given}, which is neither")
    folder = out / "images"
    command = [sys.executable, "-m", "core.scan.e57", str(given), str(folder)]
    process = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, text=True, check=False)
    if process.returncode != 0:
        raise SurveyError((process.stderr.strip().splitlines() or [f"{given} cannot be read"])[-1])
    found = json.loads(process.stdout)
    if not found["num_images"]:
        raise SurveyError(
            f"expected an E57 file with panoramas or pinhole images, got {given} with none ({found['num_others']} others); take them "
            "out with the scanner's software, and give their folder"
        )
    return folder
