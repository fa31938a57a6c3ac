"""Photos of a walk-through in several sizes, as pictures and as scripts. No size has the EXIF data of the photo, its place included."""

import base64
import io

from PIL import Image, ImageOps

from panoloc.core.exports.tour import ExportedFile, PlacedPhoto

SMALL_PX, MEDIUM_PX, LARGE_PX = 320, 2048, 8192
"""Longer sides: of a thumbnail, of what is shown at once, of what follows. Graphics processors rarely take more."""
_QUALITIES = {SMALL_PX: 70, MEDIUM_PX: 80, LARGE_PX: 85}


def has_large(photo: PlacedPhoto) -> bool:
    """Tell whether a photo has more pixels than the size in the middle."""
    return max(photo.width, photo.height) > MEDIUM_PX


def photo_files(number: int, photo: PlacedPhoto) -> list[ExportedFile]:
    """Return a photo as `NUMBER-small.jpg`, `-medium.js` and, where it has more pixels, `-large.js`. Raises OSError."""
    assert photo.image is not None
    with Image.open(photo.image) as opened:
        shown = ImageOps.exif_transpose(opened).convert("RGB")
    files = []
    if has_large(photo):
        shown.thumbnail((LARGE_PX, LARGE_PX), Image.Resampling.LANCZOS)
        files.append(_script(number, "large", _jpeg(shown, LARGE_PX)))
    shown.thumbnail((MEDIUM_PX, MEDIUM_PX), Image.Resampling.LANCZOS)
    files.append(_script(number, "medium", _jpeg(shown, MEDIUM_PX)))
    shown.thumbnail((SMALL_PX, SMALL_PX), Image.Resampling.LANCZOS)
    return [*files, ExportedFile(f"walk/photos/{number}-small.jpg", _jpeg(shown, SMALL_PX))]


def _jpeg(picture: Image.Image, size: int) -> bytes:
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=_QUALITIES[size], optimize=True, progressive=size != SMALL_PX)
    return out.getvalue()


def _script(number: int, size: str, jpeg: bytes) -> ExportedFile:
    """Return a photo as a script: a page from a folder may show a picture beside it, but not read its pixels."""
    name = f"{number}-{size}"
    data = base64.b64encode(jpeg)
    return ExportedFile(
        f"walk/photos/{name}.js", b'panolocPhoto("%s", "data:image/jpeg;base64,%s");\n' % (name.encode(), data)
    )
