"""Results of many photos, read from JSON, and the colours and fonts that all pictures of them share."""

import json
import unicodedata
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from PIL import ImageFont

from panoloc.core.geometry.pose import Pose

PhotoStatus = Literal["localized", "ambiguous", "not_localized", "failed", "waiting"]
Color = tuple[int, int, int]
Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

COLOR_OF: dict[PhotoStatus, Color] = {
    "localized": (20, 110, 220),
    "ambiguous": (225, 120, 0),
    "not_localized": (200, 30, 40),
    "failed": (120, 20, 120),
    "waiting": (120, 120, 120),
}
INK: Color = (30, 30, 34)
PAPER: Color = (250, 250, 250)
# Comes with Open3D, which reads the scans: Latin, Greek and Cyrillic, where Pillow's own font has little beyond ASCII.
_FONT = Path("resources", "Roboto-Medium.ttf")
_IN_NO_FONT = "\uffff"


@dataclass(frozen=True)
class PhotoSeen:
    """A photo and its result. number: from 1, the same in all pictures.

    poses: `map_from_camera` in the map that is drawn: one of a `localized` photo; of an `ambiguous` one the likeliest,
    then the others. image: its file, or None.
    """

    number: int
    name: str
    status: PhotoStatus
    confidence: float | None
    poses: tuple[Pose, ...]
    image: Path | None


@dataclass(frozen=True)
class Placement:
    """All photos, in order. map_name: the map that is drawn. scan: a PLY with its points, or None."""

    map_name: str
    photos: tuple[PhotoSeen, ...]
    scan: Path | None


def read_placement(path: Path) -> Placement:
    """Return what a JSON file describes: the input of the process that draws overviews.

    {"map": "map_…", "scan": null | "points.ply",
     "photos": [{"name": "a.jpg", "image": null | "/…/a.jpg", "status": "localized", "confidence": 0.9,
                 "poses": [{"frame": "ros", "position_m": [x, y, z], "quaternion_xyzw": [x, y, z, w]}]}]}
    """
    document = json.loads(path.read_text(encoding="utf-8"))
    scan = document["scan"]
    photos = tuple(_photo(number, each) for number, each in enumerate(document["photos"], 1))
    return Placement(document["map"], photos, None if scan is None else Path(scan))


def _photo(number: int, given: dict[str, Any]) -> PhotoSeen:
    poses = tuple(
        Pose.from_frame(each["position_m"], each["quaternion_xyzw"], each["frame"]) for each in given["poses"]
    )
    image = None if given["image"] is None else Path(given["image"])
    return PhotoSeen(number, given["name"], given["status"], given["confidence"], poses, image)


def font_of(size_px: int) -> Font:
    """Return a font that every installation has: which others there are differs from machine to machine."""
    package = find_spec("open3d")
    for folder in (package.submodule_search_locations or ()) if package else ():
        if Path(folder, _FONT).is_file():
            return ImageFont.truetype(Path(folder, _FONT), size_px)
    return ImageFont.load_default(size_px)


def legible(text: str, font: Font) -> str:
    """Return the text with a question mark for each letter that the font does not have."""
    lacking = bytes(font.getmask(_IN_NO_FONT))
    composed = unicodedata.normalize("NFC", text)
    return "".join("?" if bytes(font.getmask(letter)) == lacking else letter for letter in composed)


def shortened(text: str, font: Font, width_px: float) -> str:
    """Return the text, or an ellipsis and as much of its end as fits: names in a folder differ at their ends."""
    if font.getlength(text) <= width_px:
        return text
    while text and font.getlength("..." + text) > width_px:
        text = text[1:]
    return "..." + text
