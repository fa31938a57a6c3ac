"""The real format of an image file, by its first bytes: names may lie, and photos are localized by their content."""

from pathlib import Path, PurePosixPath

_HEADS = {".jpg": b"\xff\xd8\xff", ".jpeg": b"\xff\xd8\xff", ".png": b"\x89PNG"}


def why_not_as_named(name: str, image: Path) -> str | None:
    """Return why a photo that is called a JPEG or PNG is none, None when it is. Raises OSError."""
    ending = PurePosixPath(name).suffix.lower()
    with image.open("rb") as stream:
        if stream.read(4).startswith(_HEADS.get(ending, b"")):
            return None
    return f"its content does not match {ending}; rename it to match its content"
