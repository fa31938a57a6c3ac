"""Sorts the files below a folder into photos, photos in formats that are not read, and others."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from panoloc.core.options import CAMERAS_FILE
from panoloc.service.batches.archive import IMAGE_ENDINGS

_UNREAD_ENDINGS = frozenset(
    {".heic", ".heif", ".avif", ".tif", ".tiff", ".dng", ".insp", ".jxl", ".jp2", ".bmp", ".gif"}
)


@dataclass(frozen=True)
class PhotoFiles:
    """Names of files below their folder, sorted, without hidden ones. unread: photos in formats that are not read."""

    photos: list[str]
    unread: list[str]
    others: list[str]


def photo_files(folder: Path, left_out: Path, marker: str) -> PhotoFiles:
    """Return the files below a folder, except in the folder `left_out` and in folders that hold a file named `marker`."""
    found: dict[str, list[str]] = {"photos": [], "unread": [], "others": []}
    for path in _files(folder, left_out.resolve(), marker):
        ending, name = path.suffix.lower(), path.relative_to(folder).as_posix()
        kind = "photos" if ending in IMAGE_ENDINGS else "unread" if ending in _UNREAD_ENDINGS else "others"
        if name != CAMERAS_FILE:
            found[kind].append(name)
    return PhotoFiles(*(sorted(names) for names in found.values()))


def _files(photos: Path, left_out: Path, marker: str) -> Iterator[Path]:
    for folder, folders, files in os.walk(photos):
        here = Path(folder)
        if here != photos and marker in files:
            folders[:] = []
            continue
        folders[:] = [name for name in folders if not name.startswith(".") and (here / name).resolve() != left_out]
        yield from (here / name for name in files if not name.startswith("."))
