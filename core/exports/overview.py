"""Pictures of a whole placement for people: a plan (PNG) with the photos in it, and a contact sheet (JPEG) of them.

`python -m panoloc.core.exports.overview DOCUMENT.json PICTURE…` draws them.
"""

import io
import json
import math
import sys
import unicodedata
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont, ImageOps

from panoloc.core.errors import CoreError
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.conversion import converted
from panoloc.core.image.image_header import CONVERTED_KINDS, IMAGE, image_kind
from panoloc.core.options import MAX_PIXELS
from panoloc.core.scan.from_above import Area, SeenFromAbove, draw_from_above
from panoloc.core.scan.reading import read_points_of_map

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
_QUALITY = 85

# The plan.
_MAX_SIDE = 1200  # pixels
_MARGIN_M = 0.5  # around photos that lie at the edge of the scan, or beyond
_OVERHEAD_M = 0.4  # over the highest photo: what is above hides the rooms
_CEILING = 0.85  # of the height of a scan without photos
_EDGES = 0.001  # share of points, at each end, that are no part of the building
_RADIUS, _ARROW, _LEGEND = 7, 26, 34  # pixels
_SMALL = 15  # pixels of letters
_MAX_NUMBERS = 4  # of photos taken at one place
_BAR_STEPS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_EMPTY_ROOM_M = 5.0

# The contact sheet.
# Pixels of a photo by how many there are: a sheet stays small enough to look at.
_WIDTHS = ((60, 320), (300, 240), (10**9, 160))
_GAP, _FRAME = 8, 3
_NO_PICTURE = (205, 205, 210)
_PAGE_SHAPE = 1.3  # width over height


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
    photos = []
    for number, each in enumerate(document["photos"], 1):
        poses = tuple(Pose.from_frame(at["position_m"], at["quaternion_xyzw"], at["frame"]) for at in each["poses"])
        image = None if each["image"] is None else Path(each["image"])
        photos.append(PhotoSeen(number, each["name"], each["status"], each["confidence"], poses, image))
    return Placement(document["map"], tuple(photos), None if scan is None else Path(scan))


def font_of(size_px: int) -> Font:
    """Return a font that every installation has: which others there are differs from machine to machine."""
    package = find_spec("open3d")
    for folder in (package.submodule_search_locations or ()) if package else ():
        if Path(folder, _FONT).is_file():
            return ImageFont.truetype(Path(folder, _FONT), size_px)
    return ImageFont.load_default(size_px)


def legible(text: str, font: Font) -> str:
    """Return the text with a question mark for each letter that the font does not have, and for line feeds and the like."""
    lacking = bytes(font.getmask(_IN_NO_FONT))
    composed = unicodedata.normalize("NFC", text)
    return "".join(
        letter if letter.isprintable() and bytes(font.getmask(letter)) != lacking else "?" for letter in composed
    )


def shortened(text: str, font: Font, width_px: float) -> str:
    """Return the text, or an ellipsis and as much of its end as fits: names in a folder differ at their ends."""
    if font.getlength(text) <= width_px:
        return text
    while text and font.getlength("..." + text) > width_px:
        text = text[1:]
    return "..." + text


def draw_plan(placement: Placement) -> NDArray[np.uint8]:
    """Return (H, W, 3), x to the right, y up. A filled dot with an arrow along the heading is a photo. Hollow dots of the
    same number are the other poses of an ambiguous one. Below are a scale and a legend of the colours.
    """
    places = np.array([pose.position for photo in placement.photos for pose in photo.poses]).reshape(-1, 3)
    seen = _scan(placement, places)
    height, width = seen.picture.shape[:2]
    drawn = Image.new("RGB", (max(width, 700), height + _LEGEND), PAPER)
    drawn.paste(Image.fromarray(seen.picture), (0, 0))
    pen = ImageDraw.Draw(drawn)
    for photo in reversed(placement.photos):
        _draw_photo(pen, seen, photo)
    _draw_numbers(pen, seen, placement)
    _draw_legend(pen, seen, placement, height)
    return np.asarray(drawn, dtype=np.uint8)


def _scan(placement: Placement, places: NDArray[np.float64]) -> SeenFromAbove:
    positions, colors = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    if placement.scan is not None:
        cloud = read_points_of_map(placement.scan)
        positions, colors = cloud.positions.astype(np.float64) + cloud.origin_offset, cloud.colors
    corners = [np.quantile(positions, share, axis=0) for share in (_EDGES, 1 - _EDGES)] if len(positions) else []
    if len(places):
        corners += [places.min(axis=0) - _MARGIN_M, places.max(axis=0) + _MARGIN_M]
    if not corners:
        corners = [np.zeros(3), np.full(3, _EMPTY_ROOM_M)]
    lower, upper = np.min(corners, axis=0), np.max(corners, axis=0)
    top_m = float(lower[2] + _CEILING * (upper[2] - lower[2]))
    if len(places):
        top_m = min(top_m, float(places[:, 2].max()) + _OVERHEAD_M)
    return draw_from_above(positions, colors, Area(lower[:2], upper[:2], top_m), _MAX_SIDE)


def _draw_photo(pen: ImageDraw.ImageDraw, seen: SeenFromAbove, photo: PhotoSeen) -> None:
    color = COLOR_OF[photo.status]
    for rank, pose in enumerate(photo.poses):
        ((column, row),) = seen.pixels_of(pose.position[None]).tolist()
        ahead = pose.rotation[:2, 0]
        level = float(np.hypot(*ahead))
        if level > 1e-6:
            tip = column + _ARROW * ahead[0] / level, row - _ARROW * ahead[1] / level
            pen.line((column, row, *tip), fill=PAPER, width=7)
            pen.line((column, row, *tip), fill=color, width=3)
        dot = (column - _RADIUS, row - _RADIUS, column + _RADIUS, row + _RADIUS)
        pen.ellipse(dot, fill=color if rank == 0 else PAPER, outline=PAPER if rank == 0 else color, width=2)


def _draw_numbers(pen: ImageDraw.ImageDraw, seen: SeenFromAbove, placement: Placement) -> None:
    """Write the numbers of photos beside their dots; those taken at one place share a line."""
    at_place: dict[tuple[int, int], list[PhotoSeen]] = {}
    for photo in placement.photos:
        for pose in photo.poses:
            ((column, row),) = seen.pixels_of(pose.position[None]).tolist()
            at_place.setdefault((column // _RADIUS, row // _RADIUS), []).append(photo)
    for (column, row), photos in at_place.items():
        text = ", ".join(str(photo.number) for photo in photos[:_MAX_NUMBERS])
        text += f" +{len(photos) - _MAX_NUMBERS}" if len(photos) > _MAX_NUMBERS else ""
        at = (column + 2) * _RADIUS + 3, row * _RADIUS - 9
        pen.text(at, text, fill=COLOR_OF[photos[0].status], font=font_of(18), stroke_width=3, stroke_fill=PAPER)


def _draw_legend(pen: ImageDraw.ImageDraw, seen: SeenFromAbove, placement: Placement, top: int) -> None:
    bar_m = max((step for step in _BAR_STEPS_M if step * seen.pixels_per_m <= 200), default=_BAR_STEPS_M[0])
    row, at = top + _LEGEND // 2, 12.0
    pen.line((at, row, at + bar_m * seen.pixels_per_m, row), fill=INK, width=3)
    at = _write(pen, at + bar_m * seen.pixels_per_m + 6, row, f"{bar_m:g} m", INK)
    for status, color in COLOR_OF.items():
        number = sum(photo.status == status for photo in placement.photos)
        if number:
            at = _write(pen, at + 24, row, f"{number} {status.replace('_', ' ')}", color)
    shown = sum(bool(photo.poses) for photo in placement.photos)
    name = legible(placement.map_name, font_of(_SMALL))
    _write(pen, at + 24, row, f"{shown} of {len(placement.photos)} drawn; y up; {name}", INK)


def _write(pen: ImageDraw.ImageDraw, column: float, row: float, text: str, color: tuple[int, int, int]) -> float:
    font = font_of(_SMALL)
    pen.text((column, row), text, fill=color, font=font, anchor="lm")
    return column + font.getlength(text)


def draw_contact_sheet(placement: Placement) -> NDArray[np.uint8]:
    """Return (H, W, 3); frames have the colour of the status. A file that does not decode leaves an empty place."""
    photos = placement.photos
    width = next(width for most, width in _WIDTHS if len(photos) <= most)
    text = max(11, width // 20)
    cell_width, cell_height = width + _GAP, width // 2 + 2 * text + 3 * _GAP
    across = max(1, min(len(photos), round(math.sqrt(max(1, len(photos)) * _PAGE_SHAPE * cell_height / cell_width))))
    down = max(1, math.ceil(len(photos) / across))
    sheet = Image.new("RGB", (across * cell_width + _GAP, down * cell_height + _GAP), PAPER)
    with ThreadPoolExecutor() as threads:
        small = threads.map(lambda photo: _small(photo, width, width // 2), photos)
        for place, (photo, shown) in enumerate(zip(photos, small, strict=True)):
            row, column = divmod(place, across)
            _draw_thumbnail(sheet, photo, shown, _GAP + column * cell_width, _GAP + row * cell_height, width, text)
    return np.asarray(sheet, dtype=np.uint8)


def _draw_thumbnail(
    sheet: Image.Image, photo: PhotoSeen, small: Image.Image | None, left: int, top: int, width: int, text: int
) -> None:
    color, height = COLOR_OF[photo.status], width // 2
    pen = ImageDraw.Draw(sheet)
    pen.rectangle((left - _FRAME, top - _FRAME, left + width + _FRAME - 1, top + height + _FRAME - 1), fill=color)
    pen.rectangle((left, top, left + width - 1, top + height - 1), fill=_NO_PICTURE)
    if small is not None:
        sheet.paste(small, (left + (width - small.width) // 2, top + (height - small.height) // 2))
    font = font_of(text)
    name = shortened(legible(photo.name, font), font, width - font.getlength(f"{photo.number}  "))
    pen.text((left, top + height + _GAP), f"{photo.number}  {name}", fill=INK, font=font)
    sure = "" if photo.confidence is None else f" {photo.confidence:.2f}"
    said = photo.status.replace("_", " ") + sure
    pen.text((left, top + height + _GAP + text + 3), said, fill=color, font=font)


def _small(photo: PhotoSeen, width: int, height: int) -> Image.Image | None:
    if photo.image is None:
        return None
    try:
        data = photo.image.read_bytes()
        readable = converted(data, IMAGE, MAX_PIXELS) if image_kind(data) in CONVERTED_KINDS else data
        with Image.open(io.BytesIO(readable)) as opened:
            opened.draft("RGB", (width, width))
            turned = ImageOps.exif_transpose(opened)
            turned.thumbnail((width, height))
            return turned.convert("RGB")
    except (OSError, SyntaxError, ValueError, CoreError):  # what Pillow and the conversion raise for damaged files
        return None


def main(arguments: list[str]) -> int:
    """Draw the pictures and return the exit code."""
    # More pixels than Pillow likes were accepted when the photos were placed.
    Image.MAX_IMAGE_PIXELS = None
    placement = read_placement(Path(arguments[0]))
    for target in map(Path, arguments[1:]):
        if target.suffix == ".png":
            Image.fromarray(draw_plan(placement)).save(target, "PNG", optimize=True)
        else:
            Image.fromarray(draw_contact_sheet(placement)).save(target, "JPEG", quality=_QUALITY)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
