"""Files in a bucket: key `a/b` is the object `prefix/a/b`.

Uploads under way and local copies lie on this machine's disk. A write of an object is atomic by itself. A bucket that
does not answer is reported after some seconds of retries.

Nothing can be moved away in one step, so a deletion first writes a note. Then go the objects directly below the prefix,
such as `map.json`; then all others, and last the note. `tidy` finishes the deletions whose note is still there, except
for what was written after it.
"""

import hashlib
import json
import logging
import threading
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from io import BufferedIOBase
from pathlib import Path, PurePosixPath
from typing import Any

from panoloc.service.errors import ServiceError, StorageError, StoredFileChangedError, StoredFileMissingError
from panoloc.service.storage.bucket_client import open_client
from panoloc.service.storage.bucket_objects import BucketObjects, FoundObject
from panoloc.service.storage.folder import FolderStorage
from panoloc.service.storage.local_copies import LocalCopies
from panoloc.service.storage.protocol import DIGEST_SUFFIX, Stamp, Storage, check_digest, parts_of
from panoloc.service.storage.urls import BucketAccess, split_url

_log = logging.getLogger(__name__)

_PROBE = "probe"
# Readiness is asked every few seconds, and each write costs money.
_PROBE_LASTS_S = 15.0
_PAGE = 1000
_NOTES = "deleted"
# No deletion tries its first step for longer.
_UNDER_WAY_S = 3600.0


class BucketStorage(Storage):
    """Used by one or several processes; see `Storage`."""

    def __init__(self, url: str, access: BucketAccess) -> None:
        """Raise StorageAwayError for unusable variables; sends no request."""
        self.url = url
        self._objects = BucketObjects(open_client(url, access.variables), url)
        self._probes = BucketObjects(open_client(url, access.variables, is_patient=False), url)
        folder = Path(access.local_folder)
        self._local = FolderStorage(folder)
        self._copies = LocalCopies(folder / "copies", access.copies_bytes)
        # Azure lists from the beginning, wherever a list is to begin.
        self._can_skip = split_url(url)[0] != "az"
        self._probing = threading.Lock()
        self._probed_s = -_PROBE_LASTS_S

    def put(self, key: str, data: bytes) -> None:
        """Store bytes with their digest."""
        self.replace(key, data)

    def adopt(self, key: str, file: Path, digest: str) -> None:
        """Upload a file and remove it."""
        self._objects.write(_checked(key), file, digest)
        file.unlink(missing_ok=True)

    def replace(self, key: str, data: bytes, over: Stamp | None = None) -> Stamp:
        """Store bytes in one step; the bucket itself compares what is there with `over`."""
        return self._objects.write(_checked(key), data, hashlib.sha256(data).hexdigest(), over)

    def read_stamped(self, key: str) -> tuple[bytes, Stamp]:
        """Return the bytes, checked against their digest when there is one, and their stamp."""
        found, data = self._objects.read(_checked(key))
        check_digest(key, found.digest, hashlib.sha256(data).hexdigest())
        return data, found.stamp

    @contextmanager
    def local_copy(self, key: str, *, checked: bool = True) -> Iterator[Path]:
        """Give the path of a copy on this machine's disk, fetched where there is none."""
        name, copy = self._copy_of(_checked(key), checked)
        try:
            yield self._copies.path(name)
        finally:
            self._copies.release(copy)

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix, sorted, without digests."""
        found = self._objects.names(_checked(prefix))
        return sorted(name for name in found if not name.startswith(".") and not name.endswith(DIGEST_SUFFIX))

    def delete_all(self, prefix: str) -> None:
        """Delete the objects directly below a prefix, then all others; `tidy` deletes what is left then."""
        paths = [each["path"] for page in self._objects.pages(_checked(prefix)) for each in page]
        first = [path for path in paths if "/" not in path.removeprefix(f"{prefix}/")]
        rest = [path for path in paths if path not in set(first)]
        if not rest:
            self._objects.delete(first)
            return
        note = f"{_NOTES}/{uuid.uuid4().hex}.json"
        self._objects.write(note, json.dumps({"prefix": prefix, "first": first}).encode(), None)
        self._objects.delete(first)
        try:
            self._objects.delete(rest)
            self._objects.delete([note])
        except ServiceError as error:
            _log.warning("deleted objects still take space in the bucket", extra={"key": prefix, "error": str(error)})

    def delete(self, key: str) -> None:
        """Delete an object, then the digest beside it."""
        for each in (_checked(key), key + DIGEST_SUFFIX):
            self._objects.delete([each])

    def spool_folder(self) -> Path:
        """Return a folder of this machine for uploads under way."""
        return self._local.spool_folder()

    def check_writable(self) -> None:
        """Write a few bytes to the disk of this machine, and every few seconds to the bucket."""
        self._local.check_writable()
        with self._probing:
            if time.monotonic() - self._probed_s >= _PROBE_LASTS_S:
                self._probes.write(_PROBE, b"panoloc\n", None)
                self._probed_s = time.monotonic()

    def tidy(self, min_age_s: float = 0.0) -> None:
        """Remove unfinished uploads of this machine, and finish deletions."""
        self._local.tidy(min_age_s)
        for note in [each for page in self._objects.pages(_NOTES) for each in page]:
            try:
                self._finish_deletion(note, min(min_age_s, _UNDER_WAY_S))
            except (StorageError, ValueError, KeyError, TypeError) as error:
                _log.warning("a record of a deletion is ignored", extra={"key": note["path"], "error": str(error)})

    def stamps(self, prefix: str, name: str) -> dict[str, Stamp]:
        """Return the tags of the files of this name; a page of the list covers many folders."""
        found: dict[str, Stamp] = {}
        after: str | None = None
        while page := next(self._objects.pages(_checked(prefix), after=after, page=_PAGE), []):
            for each in page:
                folder, _, rest = each["path"].removeprefix(f"{prefix}/").partition("/")
                if rest == name:
                    found[folder] = self._objects.stamp_of(each)
            if len(page) < _PAGE:
                break
            # Where the wanted file has been passed, the rest of the folder is skipped: "0" sorts after "/".
            has_passed = self._can_skip and rest >= name
            after = f"{prefix}/{folder}0" if has_passed else page[-1]["path"]
        return found

    def _finish_deletion(self, note: Any, min_age_s: float) -> None:
        try:
            noted = json.loads(self._objects.read(note["path"])[1])
        except StoredFileMissingError:  # finished by another process
            return
        prefix, first = str(noted["prefix"]), set(noted["first"])
        written: datetime = note["last_modified"]
        left = [
            each["path"] for page in self._objects.pages(prefix) for each in page if each["last_modified"] <= written
        ]
        if first.intersection(left):
            # The deletion has not come to its first step, and was reported as failed; or another process is at it.
            if (datetime.now(UTC) - written).total_seconds() < min_age_s:
                return
            left = []
        self._objects.delete(left)
        self._objects.delete([note["path"]])

    def _copy_of(self, key: str, checked: bool) -> tuple[str, BufferedIOBase]:
        """Return the name of a copy, and the copy itself, which its user releases."""
        is_fresh = False
        while True:
            found = self._objects.find(key, with_beginning=False)
            name = f"{found.cache_name}{PurePosixPath(key).suffix}"
            try:
                copy = self._copies.hold(name, partial(self._fetch, found), anew=is_fresh)
            except StoredFileChangedError:  # while it was fetched
                continue
            if not checked or found.digest is None:
                return name, copy
            digest = hashlib.file_digest(copy, "sha256").hexdigest()
            if digest == found.digest:
                return name, copy
            self._copies.release(copy)
            if is_fresh:
                check_digest(key, found.digest, digest)
            is_fresh = True  # the copy has changed on this disk; the bucket has another

    def _fetch(self, found: FoundObject, file: BufferedIOBase) -> None:
        for piece in self._objects.pieces(found):
            file.write(piece)


def _checked(key: str) -> str:
    parts_of(key)
    return key
