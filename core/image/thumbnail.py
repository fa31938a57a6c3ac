"""Small copies of photos, for lists of them."""

import io

from panoloc.core.image.heif_conversion import open_decodable
from panoloc.core.image.image_header import Upload

_QUALITY = 82


def thumbnail(data: bytes, upload: Upload, max_pixels: int, max_side: int) -> bytes:
    """Return an upright JPEG of an image, no side longer than max_side pixels; of a JPEG only as much as that needs is decoded.

    Raises as `open_decodable` does.
    """
    from PIL import ImageOps

    _, image = open_decodable(data, upload, max_pixels)
    image.draft("RGB", (max_side, max_side))
    try:
        small = ImageOps.exif_transpose(image)
        small.thumbnail((max_side, max_side))
        out = io.BytesIO()
        small.convert("RGB").save(out, "JPEG", quality=_QUALITY)
    except (OSError, SyntaxError, ValueError) as error:
        raise upload.damaged_error(
            f"{upload.name}: expected a whole image, got a damaged one ({error}); send it again in full"
        ) from error
    return out.getvalue()
