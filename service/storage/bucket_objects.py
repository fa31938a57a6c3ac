"""Objects of a bucket: written whole, read in pieces, so that no long file on a slow network meets a time limit.

The digest of an object is in its metadata, so that one write stores both. An object that was copied into the bucket
from a folder has its digest in a file beside it.
"""

import contextlib
import hashlib
import re
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import (
    AlreadyExistsError,
    BaseError,
    PermissionDeniedError,
    PreconditionError,
    UnauthenticatedError,
)
from obstore.store import ObjectStore

from panoloc.service.errors import (
    ServiceError,
    StorageAwayError,
    StorageFullError,
    StorageReadOnlyError,
    StoredFileChangedError,
    StoredFileMissingError,
)
from panoloc.service.storage.protocol import DIGEST_SUFFIX, Stamp, missing
from panoloc.service.storage.urls import split_url

PIECE_BYTES = 8 * 2**20
_PARTS_AT_A_TIME = 4
_DIGEST = "sha256"
_RETRY_AFTER_S = 10
_LONGEST_REASON = 200
_CODE = re.compile(r"<Code>(\w+)</Code>|\"code\": ?\"?(\w+)")
_FULL = re.compile(r"status code: 507|XMinioStorageFull|QuotaExceeded|InsufficientStorage|AccountStorageLimit")
_NO_BUCKET = re.compile(r"NoSuchBucket|ContainerNotFound|The specified bucket does not exist")


@dataclass(frozen=True)
class FoundObject:
    """An object as it is now. e_tag: of these bytes. digest: SHA-256, hexadecimal, None where unknown.

    beginning: bytes that came with it.
    """

    key: str
    size: int
    stamp: str
    e_tag: str
    digest: str | None
    beginning: bytes

    @property
    def cache_name(self) -> str:
        """Return a name that identifies the bytes."""
        return self.digest or hashlib.sha256(f"{self.key}\n{self.stamp}".encode()).hexdigest()


class BucketObjects:
    """Blocking; of any thread. url: for messages. Every method raises as `Storage` does."""

    def __init__(self, client: ObjectStore, url: str) -> None:
        self._client = client
        self._url = url
        # Google compares generations, all others tags.
        self._compared = "version" if split_url(url)[0] == "gs" else "e_tag"

    def write(self, key: str, data: bytes | Path, digest: str | None, over: Stamp | None = None) -> Stamp:
        """Write an object and return its stamp; a file goes in pieces. over: as in `Storage.replace`."""
        options: dict[str, Any] = {"attributes": {} if digest is None else {_DIGEST: digest}}
        if over is not None:
            options["mode"] = {self._compared: over}
        if isinstance(data, bytes):
            options["use_multipart"] = False
        with bucket_errors(self._url, key, writes=True):
            put = obstore.put(
                self._client, key, data, chunk_size=PIECE_BYTES, max_concurrency=_PARTS_AT_A_TIME, **options
            )
        return self.stamp_of(put)

    def find(self, key: str, *, with_beginning: bool = True) -> FoundObject:
        """Return what is there; with_beginning: and its first piece, which is all of most objects."""
        with bucket_errors(self._url, key, writes=False):
            head: Any = {"head": True}
            found = self._get(key) if with_beginning else obstore.get(self._client, key, options=head)
            beginning = bytes(found.bytes()) if with_beginning else b""
            digest = found.attributes.get(_DIGEST)
        digest = str(digest) if digest is not None else self._digest_beside(key)
        meta = found.meta
        return FoundObject(key, meta["size"], self.stamp_of(meta), str(meta["e_tag"]), digest, beginning)

    def pieces(self, found: FoundObject) -> Iterator[bytes]:
        """Yield all bytes of an object. Raises StoredFileChangedError where somebody replaces it meanwhile."""
        if found.beginning:
            yield found.beginning
        starts = iter(range(len(found.beginning), found.size, PIECE_BYTES))
        with ThreadPoolExecutor(_PARTS_AT_A_TIME) as threads:
            # No more of them than these wait in memory.
            coming = deque(threads.submit(self._piece, found, start) for start in islice(starts, _PARTS_AT_A_TIME))
            while coming:
                yield coming.popleft().result()
                coming.extend(threads.submit(self._piece, found, start) for start in islice(starts, 1))

    def read(self, key: str) -> tuple[FoundObject, bytes]:
        """Return an object and all its bytes."""
        while True:
            found = self.find(key)
            with contextlib.suppress(StoredFileChangedError):
                return found, b"".join(self.pieces(found))

    def pages(self, prefix: str, *, after: str | None = None, page: int = 1000) -> Iterator[list[Any]]:
        """Yield descriptions of the objects below a prefix page by page, in order. after: a path to begin behind."""
        with bucket_errors(self._url, prefix, writes=False):
            found: Any = obstore.list(self._client, f"{prefix}/", offset=after, chunk_size=page)
            yield from found

    def names(self, prefix: str) -> set[str]:
        """Return the names directly below a prefix."""
        with bucket_errors(self._url, prefix, writes=False):
            found: Any = obstore.list_with_delimiter(self._client, prefix)
        return {Path(path).name for path in (*found["common_prefixes"], *(each["path"] for each in found["objects"]))}

    def delete(self, paths: list[str]) -> None:
        """Delete objects, of which some may be gone already."""
        if not paths:
            return
        with bucket_errors(self._url, paths[0], writes=True):
            if len(paths) > 1:
                # Where one is gone already, some kinds of buckets stop there.
                with contextlib.suppress(FileNotFoundError):
                    obstore.delete(self._client, paths)
                    return
            for path in paths:
                with contextlib.suppress(FileNotFoundError):
                    obstore.delete(self._client, path)

    def stamp_of(self, meta: Any) -> str:
        """Return what the bucket compares on a conditional write."""
        return str(meta[self._compared] or meta["e_tag"])

    def _piece(self, found: FoundObject, start: int) -> bytes:
        options: Any = {"range": (start, min(start + PIECE_BYTES, found.size)), "if_match": found.e_tag}
        with bucket_errors(self._url, found.key, writes=False):
            return bytes(obstore.get(self._client, found.key, options=options).bytes())

    def _get(self, key: str) -> Any:
        options: Any = {"range": (0, PIECE_BYTES)}
        try:
            return obstore.get(self._client, key, options=options)
        except BaseError as error:
            if "status code: 416" not in str(error):
                raise
            return obstore.get(self._client, key)  # an empty object has no range

    def _digest_beside(self, key: str) -> str | None:
        if key.endswith(DIGEST_SUFFIX):
            return None
        with contextlib.suppress(StoredFileMissingError):
            return self.find(key + DIGEST_SUFFIX).beginning.decode("ascii").strip()
        return None


@contextlib.contextmanager
def bucket_errors(url: str, key: str, *, writes: bool) -> Iterator[None]:
    """Raise what `Storage` promises in place of what obstore raises."""
    try:
        yield
    except (FileNotFoundError, BaseError) as error:
        raise _translated(url, key, error, writes) from error


def _translated(url: str, key: str, error: Exception, writes: bool) -> ServiceError:
    text, reason = str(error), _reason_of(error)
    if _NO_BUCKET.search(text):
        return StorageAwayError(
            f"expected a bucket at {url}, got {reason}; ask the operator to create the bucket or to correct "
            "PANOLOC_STORAGE",
            _RETRY_AFTER_S,
        )
    if isinstance(error, AlreadyExistsError | PreconditionError):
        return StoredFileChangedError(f"{key}: somebody else has replaced the file since it was read")
    if isinstance(error, FileNotFoundError):
        return missing(key)
    if _FULL.search(text):
        return StorageFullError(
            f"expected room in the bucket {url}, got {reason}; ask the operator for space", _RETRY_AFTER_S
        )
    if isinstance(error, PermissionDeniedError | UnauthenticatedError):
        kind, verb = (StorageReadOnlyError, "written") if writes else (StorageAwayError, "read")
        return kind(
            f"expected a bucket {url} that can be {verb}, got {reason}; ask the operator to check the key and its "
            "rights",
            _RETRY_AFTER_S,
        )
    return StorageAwayError(
        f"expected an answer from the bucket {url}, got {reason}; try again, or ask the operator to check the "
        "endpoint and the network",
        _RETRY_AFTER_S,
    )


def _reason_of(error: Exception) -> str:
    """Return in one line what a bucket answered."""
    text = str(error)
    code = _CODE.search(text)
    first = text.splitlines()[0][:_LONGEST_REASON] if text else type(error).__name__
    return f"{code[1] or code[2]} ({first})" if code else first
