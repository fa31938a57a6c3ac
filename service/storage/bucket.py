"""Files in a bucket: key `a/b` is the object `prefix/a/b`. Uploads under way and local copies lie on the disk of this machine.

A write of an object is atomic by itself. Errors of a bucket that is away come after some seconds of trying, never without end.
"""

import contextlib
import hashlib
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import obstore

from service.errors import StoredFileChangedError
from service.storage.bucket_client import open_client
from service.storage.bucket_deletions import BucketDeletions
from service.storage.bucket_lacks import bucket_lacks_said
from service.storage.bucket_objects import BucketObjects, FoundObject
from service.storage.folder import FolderStorage
from service.storage.local_copies import LocalCopies
from service.storage.opening import BucketAccess, split_url
from service.storage.protocol import DIGEST_SUFFIX, Stamp, check_digest, parts_of

_PROBE = "probe"
# Readiness is asked every few seconds, and each write costs money.
_PROBE_LASTS_S = 15.0
_PAGE = 1000


class BucketStorage:
    """Implements `Storage`."""

    def __init__(self, url: str, access: BucketAccess) -> None:
        """Raise StorageAwayError for variables that cannot be used; nothing is asked of the bucket yet."""
        self.url = url
        self._client = open_client(url, access.variables)
        self._objects = BucketObjects(self._client, url)
        self._probes = BucketObjects(open_client(url, access.variables, is_patient=False), url)
        self._deletions = BucketDeletions(self._client, self._objects, url)
        folder = Path(access.local_folder)
        self._local = FolderStorage(folder)
        self._copies = LocalCopies(folder / "copies", access.copies_bytes)
        # Azure lists from the beginning, wherever one wants to go on.
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

    def read(self, key: str) -> bytes:
        """Return the bytes, checked against their digest when there is one."""
        return self.read_stamped(key)[0]

    def read_stamped(self, key: str) -> tuple[bytes, Stamp]:
        """Return the bytes as `read` does, and the stamp of just these."""
        found, data = self._objects.read(_checked(key))
        check_digest(key, found.digest, hashlib.sha256(data).hexdigest())
        return data, found.stamp

    @contextmanager
    def local_copy(self, key: str, *, checked: bool = True) -> Iterator[Path]:
        """Give the path of a copy on this machine's disk, which may have been there before."""
        suffix, is_new = PurePosixPath(_checked(key)).suffix, False
        while True:
            found = self._objects.find(key, with_beginning=False)
            with contextlib.ExitStack() as stack:
                try:
                    path = stack.enter_context(self._copies.use(found.cache_name, suffix, partial(self._fetch, found)))
                except StoredFileChangedError:  # while it was fetched
                    continue
                if checked and found.digest is not None and _digest_of(path) != found.digest:
                    self._copies.forget(found.cache_name)
                    if is_new:
                        check_digest(key, found.digest, _digest_of(path))
                    is_new = True  # of a copy that has changed on this disk the bucket has another
                    continue
                yield path
                return

    def names(self, prefix: str) -> list[str]:
        """Return the names directly below a prefix, sorted, without digests."""
        with bucket_lacks_said(self.url, prefix, writes=False):
            found: Any = obstore.list_with_delimiter(self._client, _checked(prefix))
        paths = [*found["common_prefixes"], *(each["path"] for each in found["objects"])]
        names = {PurePosixPath(path).name for path in paths}
        return sorted(name for name in names if not name.startswith(".") and not name.endswith(DIGEST_SUFFIX))

    def delete_all(self, prefix: str) -> None:
        """Delete first what says that there is something, then all else; what then is left is deleted by `tidy`."""
        self._deletions.delete_all(_checked(prefix))

    def delete(self, key: str) -> None:
        """Delete an object, then what lies beside it."""
        for each in (_checked(key), key + DIGEST_SUFFIX):
            with bucket_lacks_said(self.url, key, writes=True), contextlib.suppress(FileNotFoundError):
                obstore.delete(self._client, each)

    def spool_folder(self) -> Path:
        """Return a folder of this machine for uploads under way."""
        return self._local.spool_folder()

    def check_writable(self) -> None:
        """Write a few bytes to the disk of this machine and to the bucket, to that once in a while."""
        self._local.check_writable()
        with self._probing:
            if time.monotonic() - self._probed_s >= _PROBE_LASTS_S:
                self._probes.write(_PROBE, b"panoloc\n", None)
                self._probed_s = time.monotonic()

    def tidy(self, min_age_s: float = 0.0) -> None:
        """Remove unfinished uploads of this machine, and finish deletions."""
        self._local.tidy(min_age_s)
        self._deletions.finish(min_age_s)

    def stamps(self, prefix: str, name: str) -> dict[str, Stamp]:
        """Return the tags of the files of this name, from one page of the list for many of them."""
        found: dict[str, Stamp] = {}
        offset: str | None = None
        while page := self._page(_checked(prefix), offset):
            for each in page:
                folder, _, rest = each["path"].removeprefix(f"{prefix}/").partition("/")
                if rest == name:
                    found[folder] = str(each["e_tag"] or each["version"])
            if len(page) < _PAGE:
                break
            offset = self._next_offset(prefix, page[-1]["path"], name)
        return found

    def _page(self, prefix: str, offset: str | None) -> list[Any]:
        with bucket_lacks_said(self.url, prefix, writes=False):
            pages: Any = obstore.list(self._client, f"{prefix}/", offset=offset, chunk_size=_PAGE)
            return list(next(iter(pages), []))

    def _next_offset(self, prefix: str, last: str, name: str) -> str:
        """Return what to go on after: a folder of which the wanted file has been passed is left at once, however much lies in it."""
        folder, _, rest = last.removeprefix(f"{prefix}/").partition("/")
        # "0" comes after "/" and so after everything in the folder.
        return f"{prefix}/{folder}0" if self._can_skip and rest >= name else last

    def _fetch(self, found: FoundObject, path: Path) -> None:
        with path.open("wb") as file:
            for piece in self._objects.pieces(found):
                file.write(piece)


def _checked(key: str) -> str:
    parts_of(key)
    return key


def _digest_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
