"""Colours and letters that all pictures of a placement share."""

from PIL import ImageFont

from core.exports.overview.document import PhotoStatus

Color = tuple[int, int, int]

COLOR_OF: dict[PhotoStatus, Color] = {
    "localized": (20, 110, 220),
    "ambiguous": (225, 120, 0),
    "not_localized": (200, 30, 40),
    "failed": (120, 20, 120),
    "waiting": (120, 120, 120),
}
INK: Color = (30, 30, 34)
PAPER: Color = (250, 250, 250)


def font_of(size_px: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return Pillow's own font: which others there are differs from machine to machine."""
    return ImageFont.load_default(size_px)


def shortened(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width_px: float) -> str:
    """Return the text, or as much of its end as fits after an ellipsis: photos of a folder differ at the end of their names."""
    if font.getlength(text) <= width_px:
        return text
    while text and font.getlength("..." + text) > width_px:
        text = text[1:]
    return "..." + text
