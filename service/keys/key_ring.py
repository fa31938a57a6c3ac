"""The keys that count: those of `PANOLOC_API_KEYS`, those of the keys file as it is now, and tokens."""

import logging
import os
import time
from collections.abc import Mapping
from pathlib import Path

from panoloc.service.keys.caller import ALL_SCOPES, Caller, Scope
from panoloc.service.keys.key_file import KeyFile, KeyFileError, digest_of
from panoloc.service.keys.tokens import TokenRefusedError, Tokens

_log = logging.getLogger(__name__)

# A key that was revoked opens nothing after this.
_LOOK_S = 1.0
_SHORTEST_KEY = 8
_SCOPES: dict[str, frozenset[Scope]] = {
    "read": frozenset({"read", "localize"}),
    "localize": frozenset({"localize"}),
    "write": frozenset({"read", "localize", "write"}),
}


def callers_of_setting(text: str) -> Mapping[str, Caller]:
    """Return callers, who see all tenants, by the digests of their keys. Raises ValueError without quoting a key.

    text: entries `key` or `key:scope`, separated by commas.
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


class KeyRing:
    """Used from one event loop."""

    def __init__(self, setting: str, data_dir: Path, tokens: Tokens | None = None, look_s: float = _LOOK_S) -> None:
        """setting: PANOLOC_API_KEYS; ValueError where it cannot be read. tokens: None where those of no issuer count."""
        self._of_setting = callers_of_setting(setting)
        self.tokens = tokens
        self.file = KeyFile(data_dir)
        self._look_s = look_s
        self._looked_s = -look_s
        self._seen: tuple[int, int, int] | None = None
        self._of_file: Mapping[str, Caller] = {}

    @property
    def required(self) -> bool:
        """Tell whether callers have to present a key: also where all keys are revoked, or their file cannot be read."""
        self._look()
        return bool(self._of_setting) or self._seen is not None or self.tokens is not None

    def find(self, key: str) -> Caller | None:
        """Return who brings this key or token, None for an unknown, revoked or expired one."""
        try:
            return self.caller_of(key)
        except TokenRefusedError:
            return None

    def caller_of(self, key: str) -> Caller:
        """Return who brings this key or token. Raises TokenRefusedError, which says why it opens nothing."""
        self._look()
        digest = digest_of(key)
        if found := self._of_setting.get(digest) or self._of_file.get(digest):
            return found
        if self.tokens is None or key.count(".") != 2:  # as of a JSON Web Token, which has three parts
            raise TokenRefusedError("expected a known API key, got an unknown one; ask the operator for a key")
        return self.tokens.caller_of(key)

    def look_again(self) -> None:
        """Take in what has changed in the file at once, rather than within a second."""
        self._looked_s = -self._look_s
        self._look()

    def _look(self) -> None:
        if time.monotonic() - self._looked_s < self._look_s:
            return
        self._looked_s = time.monotonic()
        seen = _version(self.file.path)
        if seen == self._seen:
            return
        if seen is None:
            # Opening the service to everybody takes more than a file that was moved away.
            if self._of_file:
                _log.error("the key file is missing; its keys are refused", extra={"path": str(self.file.path)})
            self._of_file = {}
            return
        self._seen = seen
        try:
            self._of_file = {key.sha256: key.caller for key in self.file.read() if key.revoked_at is None}
        except (KeyFileError, OSError) as error:
            _log.error("the key file cannot be read; its keys are refused", extra={"error": str(error)})
            self._of_file = {}


def _version(path: Path) -> tuple[int, int, int] | None:
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return None
    except OSError:
        return (0, 0, 0)
    return (found.st_ino, found.st_mtime_ns, found.st_size)
