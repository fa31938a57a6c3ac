"""The rooms of the engine: the files of `core/`, and their source."""

from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path

import panoloc

ROOT = Path(panoloc.__file__).resolve().parents[1]
_OTHER_ROOMS = (
    "core/scan/*",
    "core/exports/*",
    "core/paper/*",
    "core/earth/*",
    "core/changes/*",
    "core/survey/*",
    "core/sandbox.py",
)


def sources(*patterns: str, but: Sequence[str] = ()) -> dict[str, str]:
    """Return the source of every module that fits one of the patterns and none of `but`, by its file relative to the top folder."""
    files = {str(path.relative_to(ROOT)): path for pattern in patterns for path in sorted(ROOT.glob(pattern))}
    return {
        name: path.read_text(encoding="utf-8")
        for name, path in files.items()
        if not any(fnmatch(name, left_out) for left_out in but)
    }


def localizing_rooms() -> dict[str, str]:
    """Return the source of the rooms that localize, by file."""
    return sources("core/**/*.py", but=_OTHER_ROOMS)


def deciding_rooms() -> dict[str, str]:
    """Return the source of the rooms that decide on a status, by file."""
    return sources("core/decide/*.py", "core/query/*.py", "core/localizer.py")
