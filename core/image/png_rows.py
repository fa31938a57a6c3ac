"""Whether a PNG holds the pixels that its header claims: Pillow fills up what is missing with black and says nothing."""

import struct
import zlib
from collections.abc import Iterator

from panoloc.core.image.image_header import Upload

_SIGNATURE_BYTES = 8
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# Photos and pictures of scans shrink to a half or a tenth; only what shrinks further is worth a look, which takes as long as decoding.
_USUAL_RATIO = 20
_PIECE_BYTES = 1 << 20


def check_png_rows(data: bytes, upload: Upload) -> None:
    """Raise the upload's `damaged_error` when the compressed rows end before the last; of other formats do nothing."""
    if not data.startswith(b"\x89PNG"):
        return
    width, height, depth, color_type, interlaced = _header(data)
    # Interlaced images have a few bytes more.
    expected = (
        height * -(-width * depth * _CHANNELS.get(color_type, 1) // 8)
        if not interlaced
        else width * height * depth // 8
    )
    compressed = list(_compressed_rows(data))
    if expected <= _USUAL_RATIO * sum(map(len, compressed)):
        return
    found = 0
    unpacking = zlib.decompressobj()
    try:
        for rows in compressed:
            waiting: bytes = rows
            while waiting and found < expected:
                found += len(unpacking.decompress(waiting, _PIECE_BYTES))
                waiting = unpacking.unconsumed_tail
    except zlib.error as error:
        raise upload.damaged_error(f"{upload.name}: its rows are damaged ({error}); export it again") from error
    if found < expected:
        raise upload.damaged_error(
            f"{upload.name}: {width:,} x {height:,} pixels take {expected:,} bytes, got {found:,}; the file ends early, send it "
            "again in full"
        )


def _header(data: bytes) -> tuple[int, int, int, int, int]:
    width, height, depth, color_type, _, _, interlaced = struct.unpack(">IIBBBBB", data[16:29].ljust(13, b"\0"))
    return width, height, depth, color_type, interlaced


def _compressed_rows(data: bytes) -> Iterator[bytes]:
    """Yield what the IDAT chunks hold."""
    at = _SIGNATURE_BYTES
    while at + 8 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        if data[at + 4 : at + 8] == b"IDAT":
            yield data[at + 8 : at + 8 + length]
        at += 12 + length
