"""Ids and times."""

import secrets
from datetime import UTC, datetime


def new_id(prefix: str) -> str:
    """Return `prefix_` and 16 hexadecimal digits that nobody can guess."""
    return f"{prefix}_{secrets.token_hex(8)}"


def now() -> str:
    """Return the time in UTC as RFC 3339, with microseconds so that text sorts like time."""
    return datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
