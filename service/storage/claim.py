"""Keeps services that do not share out of each other's bucket: a note in it, which whoever runs writes anew every few seconds.

No clocks are compared: a note that stays as it was for as long as three renewals take was left by a process that ended without a word.
"""

import contextlib
import json
import logging
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from service.errors import ServiceError, StorageError
from service.storage.bucket import BucketStorage

_log = logging.getLogger(__name__)

_RENEW_S = 10.0
_WATCH_S = 30.0
_LOOK_S = 2.0
_SOLE, _SHARED = "claims/sole.json", "claims/shared.json"
_TOKEN_FILE = "claim"


class BucketInUseError(RuntimeError):
    """Another service uses the bucket."""


class BucketClaim:
    """Of one service, from `take` to `release`. is_shared: others that say so too may use the bucket."""

    def __init__(self, storage: BucketStorage, data_dir: Path, *, is_shared: bool) -> None:
        """data_dir: held by this service alone, so that the note of the one before on this folder is known to be of the past."""
        self._storage = storage
        self._is_shared = is_shared
        self._token = secrets.token_hex(8) if is_shared else _token_of(data_dir)
        self._num_renewals = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._renew_always, name="renew the claim of the bucket", daemon=True)
        self._when_lost: Callable[[], None] = lambda: None
        self.loss: str | None = None

    def take(self) -> None:
        """Take the bucket for this service; waits for up to half a minute to learn whether another lives.

        Raises BucketInUseError, and what `Storage` raises.
        """
        for key in (_SOLE,) if self._is_shared else (_SOLE, _SHARED):
            self._wait_until_free(key)
        self._write()
        if not self._is_shared and (other := self._other()):
            raise _in_use(self._storage.url, other)  # that came at the same moment
        self._thread.start()

    def call_when_lost(self, end: Callable[[], None]) -> None:
        """Name what is called, from another thread, when another service has taken the bucket while this one stood still."""
        self._when_lost = end

    def release(self) -> None:
        """Let the next one in at once."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        # That of those who share is of all of them.
        if not self._is_shared and self.loss is None:
            with contextlib.suppress(ServiceError):
                if self._other() is None:
                    self._storage.delete(_SOLE)

    def _wait_until_free(self, key: str) -> None:
        first = self._read(key)
        if first is None or first["token"] == self._token:
            return
        _log.warning(
            "another service has used the bucket; waiting to see whether it still does",
            extra={"other": _named(first), "longest_s": _WATCH_S},
        )
        deadline = time.monotonic() + _WATCH_S
        while time.monotonic() < deadline:
            time.sleep(min(_LOOK_S, _WATCH_S / 5))
            now = self._read(key)
            if now is None:
                return
            if now != first:
                raise _in_use(self._storage.url, now)

    def _renew_always(self) -> None:
        while not self._stopping.wait(_RENEW_S):
            try:
                other = None if self._is_shared else self._other()
                if other is None:
                    self._write()
                    continue
            except ServiceError as error:
                _log.warning("the claim of the bucket cannot be renewed, trying again", extra={"error": str(error)})
                continue
            self.loss = f"{_named(other)} has taken the bucket"
            _log.error("the service ends", extra={"error": self.loss})
            self._when_lost()
            return

    def _other(self) -> dict[str, Any] | None:
        found = self._read(_SOLE)
        return found if found is not None and found["token"] != self._token else None

    def _read(self, key: str) -> dict[str, Any] | None:
        try:
            found = json.loads(self._storage.read(key))
            return found if isinstance(found, dict) and "token" in found else None
        except (StorageError, ValueError):
            return None

    def _write(self) -> None:
        self._num_renewals += 1
        note = {
            "token": self._token,
            "machine": socket.gethostname(),
            "process": os.getpid(),
            "renewals": self._num_renewals,
        }
        self._storage.put(_SHARED if self._is_shared else _SOLE, json.dumps(note).encode())


def _token_of(data_dir: Path) -> str:
    path = data_dir / _TOKEN_FILE
    with contextlib.suppress(FileNotFoundError):
        if found := path.read_text("ascii").strip():
            return found
    path.write_text(token := secrets.token_hex(16), "ascii")
    return token


def _named(note: dict[str, Any]) -> str:
    return f"the service with process id {note.get('process')} on {note.get('machine')}"


def _in_use(url: str, note: dict[str, Any]) -> BucketInUseError:
    return BucketInUseError(
        f"{url}: expected a bucket of its own, but {_named(note)} is using it; stop that one, set PANOLOC_STORAGE to another prefix, or "
        "PANOLOC_SHARED for each of them"
    )
