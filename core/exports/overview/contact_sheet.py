"""The contact sheet: every photo small, with its number, name and status."""

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageOps

from panoloc.core.exports.overview.placement import (
    COLOR_OF,
    INK,
    PAPER,
    PhotoSeen,
    Placement,
    font_of,
    legible,
    shortened,
)

# Pixels of a photo by how many there are: a sheet stays small enough to look at.
_WIDTHS = ((60, 320), (300, 240), (10**9, 160))
_GAP, _FRAME = 8, 3
_NO_PICTURE = (205, 205, 210)
_PAGE_SHAPE = 1.3  # width over height


def draw_contact_sheet(placement: Placement) -> NDArray[np.uint8]:
    """Return (H, W, 3); frames have the colour of the status. A file that does not decode leaves an empty place."""
    photos = placement.photos
    width = next(width for most, width in _WIDTHS if len(photos) <= most)
    text = max(11, width // 20)
    cell_width, cell_height = width + _GAP, width // 2 + 2 * text + 3 * _GAP
    across = max(1, min(len(photos), round(math.sqrt(max(1, len(photos)) * _PAGE_SHAPE * cell_height / cell_width))))
    down = max(1, math.ceil(len(photos) / across))
    sheet = Image.new("RGB", (across * cell_width + _GAP, down * cell_height + _GAP), PAPER)
    for place, photo in enumerate(photos):
        row, column = divmod(place, across)
        _draw(sheet, photo, _GAP + column * cell_width, _GAP + row * cell_height, width, text)
    return np.asarray(sheet, dtype=np.uint8)


def _draw(sheet: Image.Image, photo: PhotoSeen, left: int, top: int, width: int, text: int) -> None:
    color, height = COLOR_OF[photo.status], width // 2
    pen = ImageDraw.Draw(sheet)
    pen.rectangle((left - _FRAME, top - _FRAME, left + width + _FRAME - 1, top + height + _FRAME - 1), fill=color)
    small = _small(photo, width, height)
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
        with Image.open(photo.image) as opened:
            opened.draft("RGB", (width, width))
            turned = ImageOps.exif_transpose(opened)
            turned.thumbnail((width, height))
            return turned.convert("RGB")
    except (OSError, SyntaxError, ValueError):  # what Pillow raises for damaged files
        return None
