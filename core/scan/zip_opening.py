"""Open untrusted zip archives: limits of the file list, and checks of names and entries. Needs no numpy."""

import io
import re
import stat
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

MAX_LIST_BYTES = 8 << 20
"""Of the file list at the end of an archive, which zipfile reads at once: each entry of 46 bytes takes a kilobyte of memory."""
_ENCRYPTED = 0x1


@contextmanager
def open_zip(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive for a block. Raises zipfile.BadZipFile for other files, and for a list that is too long."""
    with _BoundedReads(io.FileIO(path)) as file, _opened(file) as archive:
        yield archive


def unpacked_bytes(path: Path, most: int) -> int:
    """Return the bytes that an archive announces, at least its own size and at most `most`; of other files their size."""
    size_bytes = path.stat().st_size
    try:
        with open_zip(path) as archive:
            announced = sum(info.file_size for info in archive.infolist())
    except zipfile.BadZipFile:
        return size_bytes
    return max(size_bytes, min(announced, most))


def leads_out(name: str) -> bool:
    """Tell whether a file name leads out of the folder that the archive is unpacked into."""
    place = PurePosixPath(name.replace("\\", "/"))
    return place.is_absolute() or ".." in place.parts or re.match("[A-Za-z]:", name) is not None or "\x00" in name


def is_link(info: zipfile.ZipInfo) -> bool:
    """Tell whether an entry is a link to another file."""
    return stat.S_ISLNK(info.external_attr >> 16)


def is_encrypted(info: zipfile.ZipInfo) -> bool:
    """Tell whether an entry can only be read with a password."""
    return bool(info.flag_bits & _ENCRYPTED)


class _BoundedReads(io.BufferedReader):
    def read(self, size: int | None = -1, /) -> bytes:
        """Read bytes. Raises zipfile.BadZipFile for more than MAX_LIST_BYTES at once."""
        # The list is read by its announced length; nothing else of an archive is asked for in one piece of this size.
        if size is not None and size > MAX_LIST_BYTES:
            raise zipfile.BadZipFile(
                f"its list of files takes {size:,} bytes, more than the {MAX_LIST_BYTES:,} that are read; pack fewer files"
            )
        return super().read(size)


def _opened(file: io.BufferedReader) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(file)
    except (ValueError, OverflowError, struct.error) as error:  # of offsets that no file has
        raise zipfile.BadZipFile(str(error)) from error
    if not all(info.filename for info in archive.infolist()):
        raise zipfile.BadZipFile("a file in it has no name")
    return archive
