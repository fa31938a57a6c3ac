"""The keys of the setting `PANOLOC_API_KEYS`, which see the maps of all tenants."""

import hashlib
from collections.abc import Mapping

from service.keys.caller import ALL_SCOPES, Caller, Scope

_SCOPES: dict[str, frozenset[Scope]] = {
    "read": frozenset({"read", "localize"}),
    "localize": frozenset({"localize"}),
    "write": frozenset({"read", "localize", "write"}),
}
_SHORTEST_KEY = 8


def callers_of_setting(text: str) -> Mapping[str, Caller]:
    """Read `key` and `key:scope` entries separated by commas; return callers by the digests of their keys.

    Raises ValueError without quoting a key.
    """
    found: dict[str, Caller] = {}
    for number, entry in enumerate(filter(None, (part.strip() for part in text.split(","))), start=1):
        key, colon, scope = entry.partition(":")
        if colon and scope not in _SCOPES:
            raise ValueError(
                f"key {number}: expected `key`, or `key:` and one of {', '.join(_SCOPES)}, got another scope"
            )
        if len(key) < _SHORTEST_KEY or not key.isascii() or not key.isprintable():
            raise ValueError(f"key {number}: expected at least {_SHORTEST_KEY} printable ASCII characters")
        digest = digest_of(key)
        found[digest] = Caller(f"key setting-{digest[:8]}", _SCOPES[scope] if colon else ALL_SCOPES)
    return found


def digest_of(key: str) -> str:
    """Return what is kept of a key. Those of the keys file are 256 random bits, for which one round of SHA-256 is enough."""
    return hashlib.sha256(key.encode()).hexdigest()
