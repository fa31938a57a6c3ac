"""Unpack a zip archive into a folder that is always removed afterwards."""

import errno
import os
import re
import shutil
import socket
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from core.errors import ScanContentError, ScanDamagedError
from core.scan.archive.members import checked_members
from core.zip_opening import open_zip

_PREFIX = "panoloc-zip-"
_BLOCK_BYTES = 1 << 20
_SPARE_BYTES = 1 << 30
_PACK_AGAIN = "The archive is damaged or was cut short: pack the scan again and upload it again."


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
            members = checked_members(archive, path.stat().st_size)
            total = sum(info.file_size for info, _ in members)
            free = shutil.disk_usage(folder).free - _SPARE_BYTES
            if total > free:
                raise ScanContentError(
                    f"The zip takes {total:,} bytes unpacked, but there is room for {max(free, 0):,}. Upload the scans one by one, or ask "
                    "the operator for space."
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
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        UnicodeDecodeError,
        FileExistsError,
    ) as error:
        raise ScanDamagedError(
            f"The zip cannot be unpacked ({str(error)[:120] or type(error).__name__}). {_PACK_AGAIN}"
        ) from error
    except NotADirectoryError as error:
        raise ScanDamagedError(f"The zip uses the name of a file for a folder as well. {_PACK_AGAIN}") from error
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise ScanDamagedError(
            "The zip holds a file with a longer name than the disk takes. Shorten it, pack the scan again and upload it again."
        ) from error


def remove_remains(temporary: Path) -> None:
    """Remove the folders of killed processes of this machine; every registration begins with it."""
    for folder in temporary.glob(f"{_PREFIX}*"):
        match = re.match(rf"{_PREFIX}{re.escape(socket.gethostname())}-(\d+)-", folder.name)
        if match and not _is_alive(int(match.group(1))):
            shutil.rmtree(folder, ignore_errors=True)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
