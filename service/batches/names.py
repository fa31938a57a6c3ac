"""Names of images as they are kept: paths with `/`, printable, inside of their folder, each once."""

import re
from collections.abc import Iterable

from core.distinct_names import distinct_names

_LONGEST_NAME = 200


def unique_names(given: Iterable[str]) -> list[str]:
    """Return a name for each file in its order; what was called nothing becomes `image`, the second of a name `name-2`."""
    return distinct_names(map(_clean, given))


def _clean(name: str) -> str:
    printable = re.sub(r"[\x00-\x1f\x7f]", "", name).replace("\\", "/")
    # Cut before the parts are looked at: what is left of `photos..` could be `..`.
    parts = [part.strip() for part in printable[-_LONGEST_NAME:].split("/")]
    return "/".join(part for part in parts if part not in ("", ".", "..")) or "image"
