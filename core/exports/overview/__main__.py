"""`python -m panoloc.core.exports.overview DOCUMENT.json PICTURE...`: draw the plan (PNG) and the contact sheet
(JPEG)."""

import sys
from pathlib import Path

from PIL import Image

from panoloc.core.exports.overview.contact_sheet import draw_contact_sheet
from panoloc.core.exports.overview.placement import read_placement
from panoloc.core.exports.overview.plan import draw_plan

_QUALITY = 85


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
