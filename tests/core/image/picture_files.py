"""Image files made in memory, byte for byte where a library would not write them."""

import io
import struct
import zlib
from typing import Any

import numpy as np
import pillow_heif
from numpy.typing import NDArray
from PIL import Image


def picture(width: int = 256, height: int = 128, seed: int = 0) -> NDArray[np.uint8]:
    """Return a smooth random picture (H, W, 3)."""
    small = np.random.default_rng(seed).integers(20, 235, (8, 16, 3)).astype(np.uint8)
    return np.asarray(Image.fromarray(small).resize((width, height), Image.Resampling.BICUBIC))


def encoded(pixels: NDArray[Any], kind: str = "PNG", **options: Any) -> bytes:
    """Return an array as the bytes of an image file, an AVIF as quickly as can be."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, kind, **({"speed": 10} if kind == "AVIF" else {}), **options)
    return buffer.getvalue()


def photo_file(
    pixels: NDArray[np.uint8],
    focal_mm: object = None,
    orientation: int | None = None,
    taken: tuple[int, int] | None = None,
) -> bytes:
    """Return a JPEG whose EXIF data tell its focal length in 35 mm terms, how it is turned, and the size that it was taken in."""
    exif = Image.Exif()
    if orientation is not None:
        exif[0x0112] = orientation
    if focal_mm is not None:
        exif.get_ifd(0x8769)[0xA405] = focal_mm
    if taken is not None:
        exif.get_ifd(0x8769)[0xA002], exif.get_ifd(0x8769)[0xA003] = taken
    return encoded(pixels, "JPEG", quality=97, exif=exif)


def phone_exif(focal_mm: int = 26, orientation: int = 1) -> bytes:
    """Return EXIF data as a phone writes them: the focal length in 35 mm terms, GPS, and a note of the maker's."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    exif.get_ifd(0x8769).update({0xA405: focal_mm, 0x927C: b"Apple iOS" + bytes(70_000)})
    exif.get_ifd(0x8825).update({1: "N", 2: (47.0, 42.0, 0.0)})
    return exif.tobytes()


def heic(pixels: NDArray[Any], exif: bytes = b"", *others: NDArray[np.uint8], **options: Any) -> bytes:
    """Return pixels as the bytes of a HEIC, quickly: 8-bit (h, w, 3) or (h, w, 4), or 16-bit (h, w, 3), which are written with 10 bits.

    An orientation in `exif` turns the image as phones do it: by the container. others: further images in the file.
    """
    mode = {3: "RGB", 4: "RGBA"}[pixels.shape[2]] + (";16" if pixels.dtype == np.uint16 else "")
    file = pillow_heif.from_bytes(mode, pixels.shape[1::-1], pixels.tobytes())
    for other in others:
        file.add_from_pillow(Image.fromarray(other))
    buffer = io.BytesIO()
    quick = {"preset": "ultrafast"}
    file.save(buffer, quality=90, chroma=444, exif=exif or None, primary_index=0, enc_params=quick, **options)
    return buffer.getvalue()


def gpano_packet(
    full: tuple[int, int], left_top: tuple[int, int], size: tuple[int, int], as_elements: bool = False
) -> bytes:
    """Return an XMP packet with GPano crop fields, as attributes or as elements."""
    names = ["FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaLeftPixels", "CroppedAreaTopPixels"]
    names += ["CroppedAreaImageWidthPixels", "CroppedAreaImageHeightPixels"]
    values = dict(zip(names, (*full, *left_top, *size), strict=True))
    if as_elements:
        inner = "".join(f"<GPano:{name}>{value}</GPano:{name}>" for name, value in values.items())
        body = f"<rdf:Description>{inner}</rdf:Description>"
    else:
        fields = " ".join(f'GPano:{name}="{value}"' for name, value in values.items())
        body = f"<rdf:Description {fields}/>"
    return f'<x:xmpmeta xmlns:x="adobe:ns:meta/">{body}</x:xmpmeta>'.encode()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, bit_depth: int, color_type: int, rows: bytes) -> bytes:
    """Return a PNG from its raw rows, each with a leading filter byte."""
    return png_of_packed(width, height, bit_depth, color_type, zlib.compress(rows))


def png_of_packed(width: int, height: int, bit_depth: int, color_type: int, packed: bytes) -> bytes:
    """Return a PNG from its packed rows."""
    header = struct.pack(">IIBBBBB", width, height, bit_depth, color_type, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", header) + _chunk(b"IDAT", packed) + _chunk(b"IEND", b"")


def png_bomb(width: int, height: int) -> bytes:
    """Return a few bytes that claim to be a huge picture."""
    return png(width, height, 8, 2, b"\0" * 1000)


def png_16_bit(values: NDArray[np.uint16]) -> bytes:
    """Return a 16-bit PNG of grey (H, W) or RGB (H, W, 3) values."""
    height, width = values.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in values)
    return png(width, height, 16, 0 if values.ndim == 2 else 2, rows)
