"""API keys and what each may do."""

import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Scope = Literal["read", "write"]

_SCOPES: dict[str, frozenset[Scope]] = {
    "read": frozenset({"read"}),
    "write": frozenset({"read", "write"}),
}
_SHORTEST_KEY = 8


@dataclass(frozen=True)
class ApiKeys:
    """The keys of a service; none means that nobody is asked for one.

    scopes_by_key: "read" covers queries too, since they change no map; "write" covers everything.
    """

    scopes_by_key: Mapping[str, frozenset[Scope]]

    @classmethod
    def parse(cls, text: str) -> "ApiKeys":
        """Read `key` and `key:scope` entries separated by commas. Raises ValueError without quoting a key."""
        found: dict[str, frozenset[Scope]] = {}
        for number, entry in enumerate(filter(None, (part.strip() for part in text.split(","))), start=1):
            key, colon, scope = entry.partition(":")
            if colon and scope not in _SCOPES:
                raise ValueError(f"key {number}: expected `key`, `key:read` or `key:write`, got another scope")
            if len(key) < _SHORTEST_KEY or not key.isascii() or not key.isprintable():
                raise ValueError(f"key {number}: expected at least {_SHORTEST_KEY} printable ASCII characters")
            found[key] = _SCOPES[scope or "write"]
        return cls(found)

    @property
    def required(self) -> bool:
        """Tell whether callers have to present a key."""
        return bool(self.scopes_by_key)

    def scopes_of(self, key: str) -> frozenset[Scope] | None:
        """Return what a key may do, None for an unknown one; takes equally long for every wrong key."""
        found = None
        for known, scopes in self.scopes_by_key.items():
            if hmac.compare_digest(known.encode(), key.encode()):
                found = scopes
        return found
