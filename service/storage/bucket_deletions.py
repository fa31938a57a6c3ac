"""Deletes what lies below a prefix of a bucket, where nothing can be moved away in one step.

A note of what is to be deleted comes first, then goes what says that there is something (what lies directly below the prefix, as
`map.json` does), then all else, and last the note. Whoever finds a note later finishes what it says, save for what was written after it.
"""

import contextlib
import json
import logging
import uuid
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import obstore
from obstore.store import ObjectStore

from service.errors import ServiceError, StorageError, StoredFileMissingError
from service.storage.bucket_lacks import bucket_lacks_said
from service.storage.bucket_objects import BucketObjects

_log = logging.getLogger(__name__)

_NOTES = "deleted"
# Of a deletion whose first step may still come: nobody tries for longer.
_UNDER_WAY_S = 3600.0


@dataclass(frozen=True)
class _Listed:
    path: str
    written: datetime


class BucketDeletions:
    """Blocking; of any thread. url: for messages."""

    def __init__(self, client: ObjectStore, objects: BucketObjects, url: str) -> None:
        self._client = client
        self._objects = objects
        self._url = url

    def delete_all(self, prefix: str) -> None:
        """Delete everything below a prefix. Raises nothing any more once it is gone for whoever reads."""
        found = [each.path for each in self._listed(prefix)]
        first = [path for path in found if "/" not in path.removeprefix(f"{prefix}/")]
        rest = [path for path in found if path not in set(first)]
        if not rest:
            self._delete(prefix, first)
            return
        note = f"{_NOTES}/{uuid.uuid4().hex}.json"
        self._objects.write(note, json.dumps({"prefix": prefix, "first": first}).encode(), None)
        self._delete(prefix, first)
        try:
            self._delete(prefix, rest)
            self._delete(prefix, [note])
        except ServiceError as error:
            _log.warning("something deleted still takes room in the bucket", extra={"key": prefix, "error": str(error)})

    def finish(self, min_age_s: float) -> None:
        """Finish the deletions that were interrupted. min_age_s: of notes that another process may just have written, seconds; 0: there is
        no other."""
        for note in self._listed(_NOTES):
            try:
                self._finish(note, min(min_age_s, _UNDER_WAY_S))
            except StorageError as error:
                _log.warning("a note of a deletion is left alone", extra={"key": note.path, "error": str(error)})

    def _finish(self, note: _Listed, min_age_s: float) -> None:
        try:
            noted: dict[str, Any] = json.loads(self._objects.read(note.path)[1])
            prefix, first = str(noted["prefix"]), set(noted["first"])
        except StoredFileMissingError:  # finished by another process
            return
        except (ValueError, KeyError, TypeError):
            _log.warning("a note of a deletion cannot be read and is left alone", extra={"key": note.path})
            return
        left = [each.path for each in self._listed(prefix) if each.written <= note.written]
        if first.intersection(left):
            # What says that there is something is there: the deletion has not come to its first step, and was reported as failed.
            if (datetime.now(UTC) - note.written).total_seconds() < min_age_s:
                return
            left = []
        self._delete(prefix, left)
        self._delete(prefix, [note.path])

    def _listed(self, prefix: str) -> list[_Listed]:
        with bucket_lacks_said(self._url, prefix, writes=False):
            pages: Any = obstore.list(self._client, f"{prefix}/", chunk_size=1000)
            return [_Listed(each["path"], each["last_modified"]) for page in pages for each in page]

    def _delete(self, prefix: str, paths: list[str]) -> None:
        with bucket_lacks_said(self._url, prefix, writes=True):
            if len(paths) > 1:
                # Where one is gone already, some kinds of buckets stop there.
                with contextlib.suppress(FileNotFoundError):
                    obstore.delete(self._client, paths)
                    return
            for path in paths:
                with contextlib.suppress(FileNotFoundError):
                    obstore.delete(self._client, path)
