"""One object of a bucket: written whole, read in pieces, so that neither a long file nor a slow network meets a time limit.

Its digest is in its metadata and so of one write with it. What was copied into a bucket from a folder has it in a file beside it.
"""

import contextlib
import hashlib
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import obstore
from obstore.exceptions import BaseError
from obstore.store import ObjectStore

from service.errors import StoredFileChangedError, StoredFileMissingError
from service.storage.bucket_lacks import bucket_lacks_said
from service.storage.opening import split_url
from service.storage.protocol import DIGEST_SUFFIX, Stamp

PIECE_BYTES = 8 * 2**20
_PARTS_AT_A_TIME = 4
_DIGEST = "sha256"


@dataclass(frozen=True)
class FoundObject:
    """An object as it is now. e_tag: of just these bytes. digest: SHA-256, hexadecimal, None where nothing is known. beginning: bytes that
    came with it."""

    key: str
    size: int
    stamp: str
    e_tag: str
    digest: str | None
    beginning: bytes

    @property
    def cache_name(self) -> str:
        """Return a name that says what is in it."""
        return self.digest or hashlib.sha256(f"{self.key}\n{self.stamp}".encode()).hexdigest()


class BucketObjects:
    """Blocking; of any thread. url: for messages."""

    def __init__(self, client: ObjectStore, url: str) -> None:
        self._client = client
        self._url = url
        # Google compares generations, all others tags.
        self._compared = "version" if split_url(url)[0] == "gs" else "e_tag"

    def write(self, key: str, data: bytes | Path, digest: str | None, over: Stamp | None = None) -> Stamp:
        """Write an object and return its stamp; a file of any size goes in pieces of a few megabytes. over: as in `Storage.replace`."""
        options: dict[str, Any] = {"attributes": {} if digest is None else {_DIGEST: digest}}
        if over is not None:
            options["mode"] = {self._compared: over}
        if isinstance(data, bytes):
            options["use_multipart"] = False
        with bucket_lacks_said(self._url, key, writes=True):
            put = obstore.put(
                self._client, key, data, chunk_size=PIECE_BYTES, max_concurrency=_PARTS_AT_A_TIME, **options
            )
        return self._stamp_of(put)

    def find(self, key: str, *, with_beginning: bool = True) -> FoundObject:
        """Return what is there. with_beginning: and its first piece, which is all of most. Raises StoredFileMissingError."""
        with bucket_lacks_said(self._url, key, writes=False):
            head: Any = {"head": True}
            found = self._get(key) if with_beginning else obstore.get(self._client, key, options=head)
            beginning = bytes(found.bytes()) if with_beginning else b""
            digest = found.attributes.get(_DIGEST)
        digest = str(digest) if digest is not None else self._digest_beside(key)
        return FoundObject(
            key, found.meta["size"], self._stamp_of(found.meta), str(found.meta["e_tag"]), digest, beginning
        )

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

    def _piece(self, found: FoundObject, start: int) -> bytes:
        options: Any = {"range": (start, min(start + PIECE_BYTES, found.size)), "if_match": found.e_tag}
        with bucket_lacks_said(self._url, found.key, writes=False):
            return bytes(obstore.get(self._client, found.key, options=options).bytes())

    def _get(self, key: str) -> Any:
        options: Any = {"range": (0, PIECE_BYTES)}
        try:
            return obstore.get(self._client, key, options=options)
        except BaseError as error:
            if "status code: 416" not in str(error):
                raise
            return obstore.get(self._client, key)  # one without a single byte has no range

    def _digest_beside(self, key: str) -> str | None:
        if key.endswith(DIGEST_SUFFIX):
            return None
        with contextlib.suppress(StoredFileMissingError):
            return self.find(key + DIGEST_SUFFIX).beginning.decode("ascii").strip()
        return None

    def _stamp_of(self, meta: Any) -> str:
        return str(meta[self._compared] or meta["e_tag"])
