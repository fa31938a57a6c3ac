"""Folders whose entries survive a power cut."""

import contextlib
import os
import time
from pathlib import Path


def make_folder(folder: Path) -> None:
    """Make a folder and those that it lies in."""
    if folder.is_dir():
        return
    make_folder(folder.parent)
    folder.mkdir(exist_ok=True)
    sync_folder(folder.parent)


def age_s(path: Path) -> float:
    """Return the seconds since a file was written, or anything was put into or taken out of a folder; 0 for what is gone."""
    with contextlib.suppress(OSError):
        return max(0.0, time.time() - path.stat().st_mtime)
    return 0.0


def sync_folder(folder: Path) -> None:
    """Make a rename survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
