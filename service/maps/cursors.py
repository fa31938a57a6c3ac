"""Cursors of lists: a place in the order, as text, so that maps may come and go between two pages."""

import base64
import binascii
import json

from panoloc.service.errors import InvalidOptionsError


def encode_cursor(created_at: str, map_id: str) -> str:
    """Return the place after a map as text that survives a URL."""
    return base64.urlsafe_b64encode(json.dumps([created_at, map_id]).encode()).decode().rstrip("=")


def decode_cursor(cursor: str) -> tuple[str, str]:
    """Return what `encode_cursor` was given. Raises InvalidOptionsError."""
    try:
        padded = cursor.encode("ascii") + b"=" * (-len(cursor) % 4)
        created_at, map_id = json.loads(base64.b64decode(padded, altchars=b"-_", validate=True))
        if isinstance(created_at, str) and isinstance(map_id, str):
            return created_at, map_id
    except (ValueError, TypeError, binascii.Error, RecursionError):
        pass
    message = f"expected the next_cursor of an earlier page, got {cursor[:80]!r}; begin again without a cursor"
    raise InvalidOptionsError(f"cursor: {message}", [{"field": "cursor", "message": message}])
