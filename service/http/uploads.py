"""Reads multipart uploads while they stream in: passing a limit ends the request at once, with its rest unread.

Scans, archives and the images of a batch go to files in the storage's spool folder, hashed on the way; the images of a
query and fields stay in memory.
"""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header

from panoloc.service.errors import InvalidOptionsError, MalformedRequestError, UnwantedPartError, UploadTooLargeError
from panoloc.service.http.spool import MAX_FIELD_BYTES, PartRule, Spool, SpooledFile
from panoloc.service.limits.capacity import Held

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks

MAX_PARTS = 128
"""Of one upload, of all names together."""
# Of boundaries and headers around the parts.
_ENVELOPE_BYTES = 64 * 1024
_WRITE_BYTES = 2**20


@dataclass
class Form:
    """The parts of an upload by name. Leaving its `with` block removes the spooled files that were not taken over."""

    fields: dict[str, list[bytes]] = field(default_factory=dict)
    files: dict[str, list[SpooledFile]] = field(default_factory=dict)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.discard()

    @property
    def scan(self) -> SpooledFile | None:
        """Return the spooled file of a form that has one, None where it did not come."""
        return next((file for files in self.files.values() for file in files), None)

    def files_of(self, name: str) -> list[SpooledFile]:
        """Return the spooled parts of this name in their order."""
        return self.files.get(name, [])

    def discard(self) -> None:
        """Remove the spooled files."""
        for files in self.files.values():
            for file in files:
                file.path.unlink(missing_ok=True)

    def single(self, name: str) -> bytes | None:
        """Return the part of this name, None without one."""
        return next(iter(self.fields.get(name, [])), None)

    def all(self, name: str) -> list[bytes]:
        """Return the parts of this name in their order."""
        return self.fields.get(name, [])

    def texts(self, name: str) -> list[str]:
        """Return all parts of this name as text. Raises InvalidOptionsError when one is not UTF-8."""
        try:
            return [value.decode() for value in self.fields.get(name, [])]
        except UnicodeDecodeError as error:
            raise InvalidOptionsError.of(name, "expected UTF-8 text, got other bytes; send text") from error


async def read_form(
    chunks: AsyncIterator[bytes],
    headers: Mapping[str, str],
    rules: Mapping[str, PartRule],
    spool_folder: Path | None = None,
    held: Held | None = None,
    max_parts: int = MAX_PARTS,
) -> Form:
    """Read a multipart body part by part. spool_folder: needed where a part is spooled. held: counts what stays in
    memory. max_parts: of all names together.

    Raises MalformedRequestError, UploadTooLargeError, UnwantedPartError, StorageFullError, BytesInFlightError,
    SlowBodyError, and what `format_of` raises as soon as the head of a scan is there.
    """
    _check_length(headers, rules)
    reader = _FormReader(_boundary(headers), rules, spool_folder, held, max_parts)
    try:
        async for chunk in chunks:
            await reader.feed(chunk)
        return reader.finish()
    except BaseException:
        reader.discard()
        raise


async def read_body(chunks: AsyncIterator[bytes], max_bytes: int = MAX_FIELD_BYTES) -> bytes:
    """Return a small body whole. Raises UploadTooLargeError."""
    data = bytearray()
    async for chunk in chunks:
        data += chunk
        if len(data) > max_bytes:
            raise UploadTooLargeError(f"expected a body of at most {max_bytes:,} bytes, got more; send less")
    return bytes(data)


class _FormReader:
    def __init__(
        self,
        boundary: bytes,
        rules: Mapping[str, PartRule],
        spool_folder: Path | None,
        held: Held | None,
        max_parts: int,
    ) -> None:
        self._rules = rules
        self._max_parts = max_parts
        self._spool_folder = spool_folder
        self._held = held
        self._form = Form()
        self._headers: list[tuple[bytes, bytes]] = []
        self._header_name = b""
        self._header_value = b""
        self._num_parts = 0
        self._num_seen: Counter[str] = Counter()
        self._num_bytes: Counter[str] = Counter()
        self._name = ""
        self._rule = PartRule()
        self._value = bytearray()
        self._spool: Spool | None = None
        self._ended = False
        self._parser = self._parser_of(boundary)

    async def feed(self, chunk: bytes) -> None:
        """Take the next bytes of the body. Raises as `read_form` does."""
        try:
            self._parser.write(chunk)
        except FormParserError as error:
            raise MalformedRequestError(f"expected a multipart body, but {error}; send multipart/form-data") from error
        if self._spool is not None and self._spool.num_waiting >= _WRITE_BYTES:
            await asyncio.to_thread(self._spool.write_out)

    def finish(self) -> Form:
        """Return the parts once the body is over. Raises MalformedRequestError when it ended early."""
        if not self._ended:
            raise MalformedRequestError(
                "expected a multipart body that ends with its boundary, got a truncated one; send it again in full"
            )
        return self._form

    def discard(self) -> None:
        """Remove what has been written of spooled parts."""
        if self._spool is not None:
            self._spool.discard()
        self._form.discard()

    def _parser_of(self, boundary: bytes) -> MultipartParser:
        try:
            return MultipartParser(boundary, self._callbacks())
        except FormParserError as error:
            raise MalformedRequestError(
                f"expected a standard multipart boundary, but {error}; send a shorter one"
            ) from error

    def _callbacks(self) -> "MultipartCallbacks":
        return {
            "on_part_begin": self._begin_part,
            "on_header_field": self._on_header_field,
            "on_header_value": self._on_header_value,
            "on_header_end": self._end_header,
            "on_headers_finished": self._end_headers,
            "on_part_data": self._on_data,
            "on_part_end": self._end_part,
            "on_end": self._end,
        }

    def _begin_part(self) -> None:
        self._headers = []
        self._num_parts += 1
        if self._num_parts > self._max_parts:
            raise UploadTooLargeError(f"expected at most {self._max_parts} parts, got more; send fewer")

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _end_header(self) -> None:
        self._headers.append((self._header_name.lower(), self._header_value))
        self._header_name = self._header_value = b""

    def _end_headers(self) -> None:
        _, options = parse_options_header(dict(self._headers).get(b"content-disposition"))
        self._name = options.get(b"name", b"").decode("utf-8", "replace")
        rule = self._rules.get(self._name)
        if rule is None:
            expected = f"expected only the parts {', '.join(self._rules)}, got {self._name[:80]!r}"
            raise UnwantedPartError.of(self._name[:80], expected)
        self._num_seen[self._name] += 1
        if self._num_seen[self._name] > rule.max_parts:
            raise UnwantedPartError.of(self._name[:80], _too_many(rule))
        self._rule, self._value = rule, bytearray()
        if rule.spooled:
            assert self._spool_folder is not None
            file_name = options.get(b"filename", b"").decode("utf-8", "replace")
            self._spool = Spool(self._spool_folder, file_name, rule, self._name)

    def _on_data(self, data: bytes, start: int, end: int) -> None:
        if self._rule.spooled and self._spool is not None:
            self._spool.add(data[start:end])
        else:
            if self._held is not None:
                self._held.take(end - start)
            self._value += data[start:end]
            if len(self._value) > self._rule.max_bytes:
                raise self._rule.too_large(self._name)
        self._num_bytes[self._name] += end - start
        if self._num_bytes[self._name] > self._rule.max_total_bytes:
            raise self._rule.too_large(self._name, together=True)

    def _end_part(self) -> None:
        if self._rule.spooled and self._spool is not None:
            self._form.files.setdefault(self._name, []).append(self._spool.finish())
            self._spool = None
        else:
            self._form.fields.setdefault(self._name, []).append(bytes(self._value))

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


def _too_many(rule: PartRule) -> str:
    if rule.max_parts == 1:
        return "expected one part of this name, got several"
    return f"expected at most {rule.max_parts} parts of this name, got more; send fewer"
