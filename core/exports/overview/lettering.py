"""Colours and fonts that all pictures of a placement share."""

import unicodedata
from importlib.util import find_spec
from pathlib import Path

from PIL import ImageFont

from panoloc.core.exports.overview.document import PhotoStatus

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
