"""Unpack a zip archive into a folder that is always removed afterwards. What the archive announces is checked before."""

import errno
import os
import re
import shutil
import socket
import tempfile
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.zip_opening import is_encrypted, is_link, leads_out, open_zip

MAX_MEMBERS = 10_000
MAX_UNPACKED_BYTES = 64 << 30
MAX_RATIO = 200
"""Of unpacked to packed bytes, all files together. Tables of numbers reach 10, empty ones 1000."""
_UNSUSPICIOUS_BYTES = 256 << 20
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_UNREADABLE = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, UnicodeDecodeError, FileExistsError)
_LOCAL_HEADER_BYTES = 30
_CLUTTER = ("__macosx", "thumbs.db", "desktop.ini")
_PREFIX = "panoloc-zip-"
_BLOCK_BYTES = 1 << 20
_SPARE_BYTES = 1 << 30
_PACK_AGAIN = "The archive is damaged or truncated: pack the scan again and upload it again."


@contextmanager
def unpacked(path: Path, report: Callable[[float], None], temporary: Path) -> Iterator[Path]:
    """Unpack the archive at `path` below `temporary` and yield the folder, which is removed afterwards. report: takes 0..1.

    Raises ScanDamagedError and ScanContentError.
    """
    remove_remains(temporary)
    folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{socket.gethostname()}-{os.getpid()}-", dir=temporary))
    try:
        _unpack(path, folder, report)
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _unpack(path: Path, folder: Path, report: Callable[[float], None]) -> None:
    try:
        with open_zip(path) as archive:
            members = _checked_members(archive, path.stat().st_size)
            total = sum(info.file_size for info, _ in members)
            free = shutil.disk_usage(folder).free - _SPARE_BYTES
            if total > free:
                raise ScanContentError(
                    f"The zip takes {total:,} bytes unpacked, but there is room for {max(free, 0):,}. Upload the scans "
                    "one by one, or ask the operator for space."
                )
            num_done = 0
            for info, place in members:
                target = folder / place
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(info) as source, target.open("xb") as unpacked_file:
                    while block := source.read(_BLOCK_BYTES):
                        unpacked_file.write(block)
                        num_done += len(block)
                        report(num_done / max(total, 1))
    except _UNREADABLE as error:
        raise ScanDamagedError(
            f"The zip cannot be unpacked ({str(error)[:120] or type(error).__name__}). {_PACK_AGAIN}"
        ) from error
    except NotADirectoryError as error:
        raise ScanDamagedError(f"The zip uses the same name for a file and a folder. {_PACK_AGAIN}") from error
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise ScanDamagedError(
            "The zip holds a file name that is too long for the disk. Shorten it, pack the scan again and upload it "
            "again."
        ) from error


def remove_remains(temporary: Path) -> None:
    """Remove the folders of killed processes of this machine; every registration begins with it."""
    for folder in temporary.glob(f"{_PREFIX}*"):
        match = re.match(rf"{_PREFIX}{re.escape(socket.gethostname())}-(\d+)-", folder.name)
        try:
            if match:
                os.kill(int(match[1]), 0)
        except ProcessLookupError:
            shutil.rmtree(folder, ignore_errors=True)
        except OSError:  # a process of another user
            pass


def _checked_members(archive: zipfile.ZipFile, size_bytes: int) -> list[tuple[zipfile.ZipInfo, PurePosixPath]]:
    """Return the files of an archive with where they belong, without what systems leave in archives.

    size_bytes: of the archive. Raises ScanContentError and ScanDamagedError for what cannot or must not be unpacked.
    """
    infos = [info for info in archive.infolist() if not info.is_dir()]
    if len(infos) > MAX_MEMBERS:
        raise ScanContentError(
            f"The zip holds {len(infos):,} files; expected at most {MAX_MEMBERS:,}. Leave out files that are not scans."
        )
    places = [_checked_place(info) for info in infos]
    for info in infos:
        _check_kind(info)
    _check_sizes(infos, size_bytes)
    for name, count in Counter(str(place).casefold() for place in places).most_common(1):
        if count > 1:
            raise ScanDamagedError(f"The zip holds the file {name[:100]!r} twice. Pack it again.")
    return [(info, place) for info, place in zip(infos, places, strict=True) if not _is_clutter(place)]


def _is_clutter(place: PurePosixPath) -> bool:
    return any(part.startswith(".") or part.casefold() in _CLUTTER for part in place.parts)


def _checked_place(info: zipfile.ZipInfo) -> PurePosixPath:
    # As stored: zipfile cuts names at a zero byte.
    name = info.orig_filename.replace("\\", "/")
    place = PurePosixPath(name)
    if leads_out(name) or not place.parts:
        raise ScanDamagedError(
            f"The zip holds a file with a path outside the archive: {name[:100]!r}. Pack the scan again."
        )
    return place


def _check_kind(info: zipfile.ZipInfo) -> None:
    name = info.filename[:100]
    if is_encrypted(info):
        raise ScanContentError(f"{name!r} in the zip is encrypted. Pack it without a password.")
    if is_link(info):
        raise ScanDamagedError(f"{name!r} in the zip is a link to another file. Pack the file itself.")
    if info.compress_type not in _METHODS:
        raise ScanContentError(
            f"{name!r} in the zip is packed by method {info.compress_type}. Pack it with the method Deflate."
        )


def _check_sizes(infos: Sequence[zipfile.ZipInfo], size_bytes: int) -> None:
    unpacked, packed = sum(info.file_size for info in infos), sum(info.compress_size for info in infos)
    if packed > size_bytes:
        raise ScanDamagedError(
            f"The zip announces {packed:,} packed bytes, but the file has {size_bytes:,}. Pack the scan again and "
            "upload it again."
        )
    if unpacked > MAX_UNPACKED_BYTES or unpacked > max(MAX_RATIO * packed, _UNSUSPICIOUS_BYTES):
        raise ScanContentError(
            f"The zip of {size_bytes:,} bytes would take {unpacked:,} bytes unpacked; the limits are "
            f"{MAX_UNPACKED_BYTES:,} bytes and {MAX_RATIO} times the packed size. Upload the scans one by one."
        )
    end = 0
    for info in sorted(infos, key=lambda each: each.header_offset):
        if info.header_offset < end:  # a bomb lets many files share the same packed bytes
            raise ScanDamagedError(
                f"{info.filename[:100]!r} in the zip shares its bytes with another file. Pack the scan again."
            )
        end = info.header_offset + _LOCAL_HEADER_BYTES + info.compress_size
