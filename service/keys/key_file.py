"""The file of keys in the data folder: the digest of each key and what it may do, never the key itself."""

import contextlib
import fcntl
import hashlib
import os
import secrets
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from panoloc.service.keys.caller import ALL_SCOPES, Caller, Scope

if TYPE_CHECKING:
    from pydantic import TypeAdapter

NAME = "keys.json"


class KeyFileError(ValueError):
    """The file is not as it was written, or there is no such key."""


@dataclass(frozen=True)
class StoredKey:
    """One key. tenant: whose maps it sees and makes; keys of one tenant share theirs. Times are RFC 3339 in UTC."""

    id: str
    name: str
    tenant: str
    scopes: tuple[Scope, ...]
    sha256: str
    created_at: str
    revoked_at: str | None = None

    @property
    def caller(self) -> Caller:
        """Return who brings this key; `admin` sees the maps of all tenants and may do everything."""
        if "admin" in self.scopes:
            return Caller(f"key {self.id}", ALL_SCOPES)
        return Caller(f"key {self.id}", frozenset(self.scopes), self.tenant)


@dataclass(frozen=True)
class _Document:
    """What the file holds."""

    keys: list[StoredKey]
    format: Literal[1] = 1


@cache
def _documents() -> "TypeAdapter[_Document]":
    # Commands load this module only when they need it.
    from pydantic import TypeAdapter

    return TypeAdapter(_Document)


class KeyFile:
    """Read by the service, changed by `panoloc keys`. Blocking."""

    def __init__(self, data_dir: Path) -> None:
        self.path = data_dir / NAME
        self._lock = self.path.with_suffix(".lock")

    @property
    def is_lost(self) -> bool:
        """Tell whether keys were made here, but their file is gone: its lock is left."""
        return self._lock.exists() and not self.path.exists()

    def read(self) -> list[StoredKey]:
        """Return all keys that were ever made, none where there is no file. Raises KeyFileError and OSError."""
        from pydantic import ValidationError

        try:
            return _documents().validate_json(self.path.read_bytes()).keys
        except FileNotFoundError:
            return []
        except ValidationError as error:
            found = error.errors(include_input=False)[0]
            where = ".".join(map(str, found["loc"])) or "the file"
            raise KeyFileError(
                f"{self.path}: expected keys in the format of `panoloc keys`, but {where}: {found['msg']}; restore it"
            ) from error

    def make(self, name: str, scopes: Sequence[Scope], tenant: str | None = None) -> tuple[StoredKey, str]:
        """Add a key and return it with its text, which is shown once. tenant: None for one of its own.

        Raises KeyFileError for a name or tenant that would not say whose the key is.
        """
        if not name.strip():
            raise KeyFileError("expected a name for the key's owner, got none")
        for text in (name, tenant or ""):
            if not text.isprintable():
                raise KeyFileError(f"expected a name or tenant without control characters, got {text[:80]!r}")
        if tenant is not None and tenant.strip() in ("", "*"):
            raise KeyFileError(
                f"expected the name of a tenant, got {tenant!r}; `*` means all tenants when sharing maps"
            )
        key_id, text = f"key_{secrets.token_hex(4)}", f"pk_{secrets.token_urlsafe(32)}"
        made = StoredKey(key_id, name, tenant or key_id, tuple(scopes), digest_of(text), _now())
        self._change(lambda keys: [*keys, made])
        return made, text

    def revoke(self, key_id: str) -> StoredKey:
        """Revoke a key. Raises KeyFileError for an unknown one."""
        revoked: list[StoredKey] = []

        def without(keys: list[StoredKey]) -> list[StoredKey]:
            found = [replace(key, revoked_at=key.revoked_at or _now()) if key.id == key_id else key for key in keys]
            revoked.extend(key for key in found if key.id == key_id)
            if not revoked:
                raise KeyFileError(f"expected the id of a key, got {key_id[:80]!r}; `panoloc keys list` shows them")
            return found

        if not self.path.exists():
            raise KeyFileError(
                f"expected keys in {self.path.parent.resolve()}, got none; check that it is the data folder of the "
                "service"
            )
        self._change(without)
        return revoked[0]

    def _change(self, update: Callable[[list[StoredKey]], list[StoredKey]]) -> None:
        self.path.parent.mkdir(0o700, parents=True, exist_ok=True)
        with self._locked():
            document = _documents().dump_json(_Document(update(self.read())), indent=1)
            part = self.path.with_suffix(".part")
            try:
                with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
                    file.write(document)
                    file.flush()
                    os.fsync(file.fileno())
                part.replace(self.path)
            except OSError as error:
                part.unlink(missing_ok=True)
                # An error while writing, as on a full disk, names no file.
                error.filename = error.filename or str(part)
                raise

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        with open(os.open(self._lock, os.O_WRONLY | os.O_CREAT, 0o600), "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield


def digest_of(key: str) -> str:
    """Return what is kept of a key. One round of SHA-256 is enough for the 256 random bits of `KeyFile.make`."""
    return hashlib.sha256(key.encode()).hexdigest()


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
