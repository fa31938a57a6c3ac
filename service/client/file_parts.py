"""Files as parts of a multipart form."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

FilePart = tuple[str, Any, str]
"""Name, content and media type, as httpx takes them."""


def paths_of(given: Path | Sequence[Path] | None) -> list[Path]:
    """Return the given files as a list."""
    if given is None:
        return []
    return [given] if isinstance(given, Path) else list(given)


def image_part(path: Path, content: Any) -> FilePart:
    """Return an image as a part. content: the open file."""
    types = {".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".png": "image/png", ".webp": "image/webp"}
    return sendable(path.name), content, types.get(path.suffix.lower(), "application/octet-stream")


def sendable(name: str) -> str:
    """Return a file name as valid UTF-8; other bytes become question marks."""
    return name.encode("utf-8", "replace").decode()
