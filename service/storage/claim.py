"""Checks at the start that a bucket does what the service needs, and keeps services that do not share it out of it.

Each service renews a note in its bucket. No clocks are compared: a note that stays unchanged for as long as three
renewals take was left by a killed process.
"""

import contextlib
import json
import logging
import os
import secrets
import socket
import threading
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

from panoloc.service.errors import ServiceError, StorageError, StoredFileChangedError
from panoloc.service.storage.bucket import BucketStorage

_log = logging.getLogger(__name__)

_RENEW_S = 10.0
_WATCH_S = 30.0
_LOOK_S = 2.0
_NOTE = "claim.json"
_TOKEN_FILE = "claim"


class BucketUnusableError(RuntimeError):
    """The bucket cannot be used as it is configured, or another service uses it; the message names the correction."""


class BucketClaim:
    """Of one service, from `take` to `release`.

    is_shared: others with the same setting may use the bucket too. when_lost: called, from another thread, when another service took the
    bucket while this one stood still.
    """

    def __init__(self, storage: BucketStorage, data_dir: Path, *, is_shared: bool) -> None:
        """data_dir: locked by this service, so that a note with the token in it is of this service's last run."""
        self._storage = storage
        self._is_shared = is_shared
        self._token = secrets.token_hex(8) if is_shared else _token_of(data_dir)
        self._num_renewals = 0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._renew_always, name="renew the claim of the bucket", daemon=True)
        self.when_lost: Callable[[], None] = lambda: None
        self.loss: str | None = None

    def take(self) -> None:
        """Check the bucket and take it for this service; waits for up to half a minute to learn whether another one lives.

        Raises BucketUnusableError, and what `Storage` raises.
        """
        check_bucket(self._storage, is_shared=self._is_shared)
        self._wait_until_free()
        self._write()
        if other := self._other():
            raise _in_use(self._storage.url, other)  # that came at the same moment
        self._thread.start()

    def release(self) -> None:
        """Stop, and let the next service in at once."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        # The note of services that share is of all of them.
        if not self._is_shared and self.loss is None:
            with contextlib.suppress(ServiceError):
                if self._other() is None:
                    self._storage.delete(_NOTE)

    def _wait_until_free(self) -> None:
        first = self._other()
        if first is None:
            return
        _log.warning(
            "another service has used the bucket; waiting to check whether it still runs",
            extra={"other": _named(first), "longest_s": _WATCH_S},
        )
        deadline = time.monotonic() + _WATCH_S
        while time.monotonic() < deadline:
            time.sleep(min(_LOOK_S, _WATCH_S / 5))
            now = self._other()
            if now is None:
                return
            if now != first:
                raise _in_use(self._storage.url, now)

    def _renew_always(self) -> None:
        while not self._stopping.wait(_RENEW_S):
            try:
                other = self._other()
                if other is None:
                    self._write()
                    continue
            except ServiceError as error:
                _log.warning(
                    "the claim on the bucket cannot be renewed; the service retries", extra={"error": str(error)}
                )
                continue
            self.loss = f"{_named(other)} has taken the bucket"
            _log.error("the service ends", extra={"error": self.loss})
            self.when_lost()
            return

    def _other(self) -> dict[str, Any] | None:
        """Return the note of a service that does not share the bucket with this one, if there is one."""
        try:
            found = json.loads(self._storage.read(_NOTE))
            if found["token"] == self._token or (self._is_shared and found["is_shared"]):
                return None
            return dict(found)
        except (StorageError, ValueError, KeyError, TypeError):
            return None

    def _write(self) -> None:
        self._num_renewals += 1
        note = {
            "token": self._token,
            "is_shared": self._is_shared,
            "machine": socket.gethostname(),
            "process": os.getpid(),
            "renewals": self._num_renewals,
        }
        self._storage.put(_NOTE, json.dumps(note).encode())


def check_bucket(storage: BucketStorage, *, is_shared: bool) -> None:
    """Write, list, read and delete a probe. is_shared: also replace it conditionally. Raises BucketUnusableError."""
    prefix = f"probes/{uuid.uuid4().hex}"
    key = f"{prefix}/probe"
    try:
        storage.put(key, b"first")
        if storage.names(prefix) != ["probe"]:
            raise BucketUnusableError(f"expected {storage.url} to list a file that was just written, but it does not")
        _, stamp = storage.read_stamped(key)
        if is_shared:
            storage.replace(key, b"second", stamp)
            with contextlib.suppress(StoredFileChangedError):
                storage.replace(key, b"third", stamp)
                raise BucketUnusableError(
                    f"expected {storage.url} to refuse the overwrite of a changed file (If-Match), which several API "
                    "replicas need, but it accepted the write; use a newer version of that storage, or one API "
                    "replica without PANOLOC_SHARED"
                )
        storage.delete_all(prefix)
    except StorageError as error:
        raise BucketUnusableError(f"{storage.url} does not keep a written file: {error}") from error
    except ServiceError as error:
        raise BucketUnusableError(str(error)) from error


def _token_of(data_dir: Path) -> str:
    path = data_dir / _TOKEN_FILE
    with contextlib.suppress(FileNotFoundError):
        if found := path.read_text("ascii").strip():
            return found
    path.write_text(token := secrets.token_hex(16), "ascii")
    return token


def _named(note: dict[str, Any]) -> str:
    return f"the service with process id {note.get('process')} on {note.get('machine')}"


def _in_use(url: str, note: dict[str, Any]) -> BucketUnusableError:
    return BucketUnusableError(
        f"{url}: expected an unused bucket prefix, but {_named(note)} is using it; stop that one, set "
        "PANOLOC_STORAGE to another prefix, or set PANOLOC_SHARED for both services"
    )
