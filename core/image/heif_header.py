"""The header of a HEIC or AVIF file, read without their decoders: how large its image is, so that a bomb is refused before it is decoded.

Both are trees of boxes (ISO/IEC 14496-12): a size, four letters, and the content. Needs no numpy.
"""

import struct
from collections.abc import Iterator

from PIL import ImageFile

HEIF = "HEIF"
"""Of an image that has to be converted before it can be decoded."""
_PATH_TO_SIZES = (b"meta", b"iprp", b"ipco")
_VERSION_AND_FLAGS = 4
_MOST_BOXES = 10_000  # of one parent; a phone's photo has a hundred


class HeifHeader(ImageFile.ImageFile):
    """An image of known size that cannot be decoded here: see `panoloc.core.image.conversion`.

    The size is the largest in the file, which is that of the whole image: others are tiles, thumbnails, depth and gain maps. It is that of
    the image as stored; a quarter turn of the container is not applied.
    """

    format = HEIF
    format_description = "HEIC or AVIF"

    def _open(self) -> None:
        assert self.fp is not None
        data = self.fp.read()
        sizes = list(_sizes(data))
        if not sizes:
            raise SyntaxError("it holds no still image, which sequences do not, or ends before its size")
        self._size = max(sizes, key=lambda size: size[0] * size[1])
        self._mode = "RGB"


def _sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield width and height of each image of a file."""
    start, end = 0, len(data)
    for name in _PATH_TO_SIZES:
        found = next((place for kind, *place in _boxes(data, start, end) if kind == name), None)
        if found is None:
            return
        start, end = found
        start += _VERSION_AND_FLAGS if name == b"meta" else 0
    for kind, begin, last in _boxes(data, start, end):
        if kind == b"ispe" and last - begin >= _VERSION_AND_FLAGS + 8:
            width, height = struct.unpack_from(">II", data, begin + _VERSION_AND_FLAGS)
            if width and height:
                yield width, height


def _boxes(data: bytes, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Yield of each box its four letters, and where its content begins and ends."""
    for _ in range(_MOST_BOXES):
        if start + 8 > end:
            return
        size, kind = struct.unpack_from(">I4s", data, start)
        begin = start + 8
        if size == 1 and begin + 8 <= end:  # the size follows, in 64 bits
            (size,) = struct.unpack_from(">Q", data, begin)
            begin += 8
        last = end if size == 0 else start + size
        if last < begin or last > end:
            return
        yield kind, begin, last
        start = last
