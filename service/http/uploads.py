"""Reads multipart uploads while they stream in: passing a limit ends the request at once, with its rest unread.

Scans, archives and the images of a batch go to files in the storage's spool folder, hashed and checked on the way; the
images of a query and fields stay in memory.
"""

import asyncio
import contextlib
import hashlib
import uuid
from collections import Counter, defaultdict
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from panoloc.core.scan.format_detection import HEAD_BYTES
from panoloc.service.errors import InvalidOptionsError, MalformedRequestError, UploadTooLargeError
from panoloc.service.limits.capacity import Held
from panoloc.service.storage.disk import disk_errors

MAX_PARTS = 128
"""Of one upload, of all names together."""
_FIELD_BYTES = 64 * 1024
_ENVELOPE_BYTES = 64 * 1024  # of boundaries and headers around the parts
_WRITE_BYTES = 2**20


@dataclass(frozen=True)
class PartRule:
    """What parts of one name may be.

    max_bytes: of one part. setting: the name of that limit. spooled: written to a file. max_parts: how often it may
    come. max_full_parts: how many of them may have `max_bytes`; all together have no more bytes than these. check_head:
    called with the first bytes of a spooled file and its name; raises for an unwanted format.
    """

    max_bytes: int = _FIELD_BYTES
    setting: str | None = None
    spooled: bool = False
    max_parts: int = 1
    max_full_parts: int = 1
    check_head: Callable[[bytes, str], object] = lambda head, name: None

    @property
    def max_total_bytes(self) -> int:
        """Return the bytes of all parts of this name together."""
        return self.max_bytes * self.max_full_parts

    def too_large(self, name: str, got: str = "more", together: bool = False) -> UploadTooLargeError:
        """Return the error for a part that is larger than allowed, or for parts of one name that are so together."""
        most, whose, times = self.max_bytes, "", ""
        if together:
            most, whose = self.max_total_bytes, " in all parts of this name together"
            times = f"{self.max_full_parts} times "
        limit = f" ({times}{self.setting})" if self.setting else ""
        return UploadTooLargeError(
            f"{name}: expected at most {most:,} bytes{whose}{limit}, got {got}; send smaller files"
        )


@dataclass
class SpooledFile:
    """A file on its way into the storage. name: at the client; sha256: hexadecimal."""

    name: str
    path: Path
    num_bytes: int
    sha256: str


@dataclass
class Form:
    """The parts of an upload by name, each in the order in which they came."""

    fields: defaultdict[str, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    files: defaultdict[str, list[SpooledFile]] = field(default_factory=lambda: defaultdict(list))

    def options(self) -> bytes | None:
        """Return the part `options`, None without one."""
        return next(iter(self.fields["options"]), None)

    def texts(self, name: str) -> list[str]:
        """Return all parts of this name as text. Raises InvalidOptionsError when one is not UTF-8."""
        try:
            return [value.decode() for value in self.fields[name]]
        except UnicodeDecodeError as error:
            raise InvalidOptionsError.of(name, "expected UTF-8 text, got other bytes; send text") from error


@asynccontextmanager
async def read_form(
    chunks: AsyncIterator[bytes],
    headers: Mapping[str, str],
    rules: Mapping[str, PartRule],
    spool_folder: Path | None = None,
    held: Held | None = None,
    max_parts: int = MAX_PARTS,
) -> AsyncIterator[Form]:
    """Read a multipart body part by part. At the end of the `with` block, files that nobody took over are removed.

    spool_folder: needed where a part is spooled. held: counts what stays in memory. max_parts: of all names together.
    Raises MalformedRequestError, UploadTooLargeError, InvalidOptionsError, StorageFullError, BytesInFlightError,
    SlowBodyError, and what a rule raises as soon as the head of a file is there.
    """
    _check_length(headers, rules)
    reader = _FormReader(rules, spool_folder, held, max_parts)
    try:
        await reader.read(chunks, _boundary(headers))
        yield reader.form
    finally:
        reader.discard()


async def read_body(
    chunks: AsyncIterator[bytes], max_bytes: int = _FIELD_BYTES, setting: str | None = None, held: Held | None = None
) -> bytes:
    """Return a body whole. setting: the name of the limit. held: counts it. Raises UploadTooLargeError and
    BytesInFlightError."""
    data, rule = bytearray(), PartRule(max_bytes, setting)
    async for chunk in chunks:
        data += chunk
        if len(data) > max_bytes:
            raise rule.too_large("body")
        if held is not None:
            held.take(len(chunk))
    return bytes(data)


class Spool:
    """Writes a part to a file; bytes wait in memory until `write_out`, which may run in another thread."""

    def __init__(self, folder: Path, name: str, rule: PartRule) -> None:
        self._name, self._check_head = name, rule.check_head
        self._path = folder / uuid.uuid4().hex
        with disk_errors():
            self._file: BinaryIO = self._path.open("wb")
        self._digest = hashlib.sha256()
        self._head = b""
        self._num_bytes = 0
        self.waiting = bytearray()

    def add(self, data: bytes) -> None:
        """Take more bytes. Raises what the rule raises as soon as the head is there."""
        self._num_bytes += len(data)
        self.waiting += data
        if not self._head and self._num_bytes >= HEAD_BYTES:
            self._look_at_head()

    def write_out(self) -> None:
        """Write and hash what waits. Raises StorageFullError and StorageReadOnlyError."""
        self._digest.update(self.waiting)
        with disk_errors():
            self._file.write(self.waiting)
        self.waiting.clear()

    def finish(self) -> SpooledFile:
        """Close the file and return what is in it. Raises as `add` and `write_out` do."""
        if not self._head:
            self._look_at_head()
        self.write_out()
        with disk_errors():
            # The last bytes leave the buffer only now.
            self._file.close()
        return SpooledFile(self._name, self._path, self._num_bytes, self._digest.hexdigest())

    def discard(self) -> None:
        """Remove the file."""
        with contextlib.suppress(OSError):  # of a full disk, once more
            self._file.close()
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _look_at_head(self) -> None:
        self._head = bytes(self.waiting[:HEAD_BYTES])
        self._check_head(self._head, self._name)


class _FormReader:
    def __init__(
        self, rules: Mapping[str, PartRule], spool_folder: Path | None, held: Held | None, max_parts: int
    ) -> None:
        self.form = Form()
        self._rules, self._spool_folder, self._held, self._max_parts = rules, spool_folder, held, max_parts
        self._headers: dict[bytes, bytes] = {}
        self._header_name = self._header_value = b""
        self._num_parts: Counter[str] = Counter()
        self._num_bytes: Counter[str] = Counter()
        # Of the part that is being read.
        self._name, self._rule, self._value, self._part_bytes = "", PartRule(), bytearray(), 0
        self._spool: Spool | None = None
        self._ended = False

    async def read(self, chunks: AsyncIterator[bytes], boundary: bytes) -> None:
        """Read the whole body. Raises as `read_form` does."""
        try:
            parser = MultipartParser(
                boundary,
                {
                    "on_header_field": self._on_header_field,
                    "on_header_value": self._on_header_value,
                    "on_header_end": self._end_header,
                    "on_headers_finished": self._begin_part,
                    "on_part_data": self._on_data,
                    "on_part_end": self._end_part,
                    "on_end": self._end,
                },
            )
            async for chunk in chunks:
                parser.write(chunk)
                if self._spool is not None and len(self._spool.waiting) >= _WRITE_BYTES:
                    await asyncio.to_thread(self._spool.write_out)
        except FormParserError as error:
            raise MalformedRequestError(f"expected a multipart body, but {error}; send multipart/form-data") from error
        if not self._ended:
            raise MalformedRequestError(
                "expected a multipart body that ends with its boundary, got a truncated one; send it again in full"
            )

    def discard(self) -> None:
        """Remove what has been written of spooled parts."""
        if self._spool is not None:
            self._spool.discard()
        for files in self.form.files.values():
            for file in files:
                file.path.unlink(missing_ok=True)

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _end_header(self) -> None:
        self._headers[self._header_name.lower()] = self._header_value
        self._header_name = self._header_value = b""

    def _begin_part(self) -> None:
        _, options = parse_options_header(self._headers.get(b"content-disposition"))
        self._headers = {}
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        rule, shown = self._rules.get(self._name), self._name[:80]
        if rule is None:
            raise InvalidOptionsError.of(shown, f"expected only the parts {', '.join(self._rules)}, got {shown!r}")
        self._num_parts[self._name] += 1
        if self._num_parts.total() > self._max_parts:
            raise UploadTooLargeError(f"expected at most {self._max_parts} parts, got more; send fewer")
        if self._num_parts[self._name] > rule.max_parts:
            most = "one part" if rule.max_parts == 1 else f"at most {rule.max_parts} parts"
            raise InvalidOptionsError.of(shown, f"expected {most} of this name, got more; send fewer")
        self._rule, self._value, self._part_bytes = rule, bytearray(), 0
        if rule.spooled:
            assert self._spool_folder is not None
            self._spool = Spool(self._spool_folder, options.get(b"filename", b"").decode("utf-8", "replace"), rule)

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        self._part_bytes += end - start
        self._num_bytes[self._name] += end - start
        if self._part_bytes > self._rule.max_bytes:
            raise self._rule.too_large(self._name)
        if self._num_bytes[self._name] > self._rule.max_total_bytes:
            raise self._rule.too_large(self._name, together=True)
        if self._spool is not None:
            self._spool.add(data[start:end])
            return
        if self._held is not None:
            self._held.take(end - start)
        self._value += data[start:end]

    def _end_part(self) -> None:
        if self._spool is None:
            self.form.fields[self._name].append(bytes(self._value))
        else:
            self.form.files[self._name].append(self._spool.finish())
            self._spool = None

    def _end(self) -> None:
        self._ended = True


def _boundary(headers: Mapping[str, str]) -> bytes:
    kind, options = parse_options_header(headers.get("content-type"))
    if kind != b"multipart/form-data" or not options.get(b"boundary"):
        raise MalformedRequestError(
            f"expected multipart/form-data with a boundary, got {headers.get('content-type', 'no content type')[:80]!r}"
        )
    return options[b"boundary"]


def _check_length(headers: Mapping[str, str], rules: Mapping[str, PartRule]) -> None:
    """Refuse by the declared length what would be refused later, before a byte is read."""
    declared = headers.get("content-length", "")
    name, largest = max(rules.items(), key=lambda item: item[1].max_total_bytes)
    allowed = sum(rule.max_total_bytes for rule in rules.values()) + _ENVELOPE_BYTES
    if declared.isdigit() and int(declared) > allowed:
        raise largest.too_large(name, f"a request of {int(declared):,}", together=largest.max_full_parts > 1)
