"""Lines of numbers, read in bounded blocks: the body of ascii PLY and PCD files and of XYZ, TXT, CSV and PTS."""

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanDamagedError
from panoloc.core.scan.reading_context import CHUNK_ROWS

BLOCK_BYTES = 1 << 22
_NEWLINE = 10
_WHITESPACE = np.isin(np.arange(256), np.frombuffer(b" \t\n\v\f\r", np.uint8))
# How C runtimes and table programs spell "not a number".
_MISSING_VALUE = re.compile(rb"(?i)(?<!\S)[-+]?(?:nan\(\w*\)|1\.#\w+|null|none|n/?a)(?!\S)")


@dataclass(frozen=True)
class TextBlock:
    """Whole lines, blank ones left out of the arrays.

    begins, ends: (n,) byte positions of each line in `text`. num_values: (n,) values in each line. numbers: (n,) line
    numbers in the file, from 1. end_offset: file position behind the block.
    """

    text: bytes
    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    num_values: NDArray[np.int64]
    numbers: NDArray[np.int64]
    end_offset: int

    def __len__(self) -> int:
        return len(self.begins)

    def line(self, row: int) -> bytes:
        """Return the text of one line without its end."""
        return self.text[self.begins[row] : self.ends[row]].strip()

    def excerpt(self, row: int) -> str:
        """Return the beginning of a line for an error message."""
        return repr(self.line(row)[:60].decode("utf-8", errors="replace"))

    def rows(self, chosen: slice | NDArray[np.bool_]) -> "TextBlock":
        """Return some of the lines as a block of their own."""
        begins, ends, values, numbers = (
            array[chosen] for array in (self.begins, self.ends, self.num_values, self.numbers)
        )
        return TextBlock(self.text, begins, ends, values, numbers, self.end_offset)

    def without(self, dropped: NDArray[np.bool_]) -> "TextBlock":
        """Return a block without the marked lines, which become blank."""
        if not dropped.any():
            return self
        text = bytearray(self.text)
        for begin, end in zip(self.begins[dropped].tolist(), self.ends[dropped].tolist(), strict=True):
            text[begin:end] = b" " * (end - begin)
        return replace(self, text=bytes(text)).rows(~dropped)

    def to_table(self, num_columns: int) -> NDArray[np.float64]:
        """Parse all lines as (n, num_columns) float64; raise ScanDamagedError naming the first line that differs."""
        if not len(self):
            return np.empty((0, num_columns))
        odd = np.flatnonzero(self.num_values != num_columns)
        if len(odd):
            row = int(odd[0])
            raise ScanDamagedError(
                f"Line {self.numbers[row]:,} has {self.num_values[row]} values, expected {num_columns}: "
                f"{self.excerpt(row)}. The file is damaged or truncated; export the scan again."
            )
        return self.to_values().reshape(len(self), num_columns)

    def to_values(self) -> NDArray[np.float64]:
        """Parse every value of all lines as one flat float64 array."""
        text = self.text[self.begins[0] : self.ends[-1]]
        num_values = int(self.num_values.sum())
        values = parse_numbers(text)
        if values is None or len(values) != num_values:
            values = parse_numbers(_MISSING_VALUE.sub(b"nan", text))
        if values is None or len(values) != num_values:
            raise self._not_a_number_error()
        return values

    def _not_a_number_error(self) -> ScanDamagedError:
        for row in range(len(self)):
            values = parse_numbers(_MISSING_VALUE.sub(b"nan", self.line(row)))
            if values is None or len(values) != self.num_values[row]:
                return ScanDamagedError(
                    f"Line {self.numbers[row]:,} holds a value that is not a number: {self.excerpt(row)}. "
                    "Export the scan again."
                )
        return ScanDamagedError(f"The lines from {self.numbers[0]:,} on hold values that are not numbers.")


class TextLines:
    """The lines of a stream from its current position on, block by block.

    table: what `substitutions` returns. Raises ScanDamagedError for a line longer than a block.
    """

    def __init__(self, stream: BinaryIO, first_line: int = 1, table: bytes | None = None):
        self._stream = stream
        self._next_line = first_line
        self._pending: TextBlock | None = None
        self._rest = b""
        self._table = table or substitutions()

    def take(self, max_lines: int) -> TextBlock | None:
        """Return the next block of at most `max_lines` lines that are not blank, or None at the end of the file."""
        while self._pending is None or not len(self._pending):
            text = self._read_lines()
            if not text:
                return None
            self._pending = self._split(text)
        block, self._pending = self._pending.rows(slice(max_lines)), self._pending.rows(slice(max_lines, None))
        return block

    def iter_rows(self, count: int, announcer: str, what: str) -> Iterator[TextBlock]:
        """Yield blocks of `count` lines together. Raises ScanDamagedError where the file ends before.

        announcer, what: for the message, such as "The PCD header" and "points".
        """
        num_done = 0
        while num_done < count:
            block = self.take(min(CHUNK_ROWS, count - num_done))
            if block is None:
                raise ScanDamagedError(
                    f"{announcer} announces {count:,} {what}, but the file ends after {num_done:,} of them. {CUT_SHORT}"
                )
            num_done += len(block)
            yield block

    def _read_lines(self) -> bytes:
        text = self._rest + self._stream.read(BLOCK_BYTES)
        end = text.rfind(b"\n") + 1 or text.rfind(b"\r") + 1
        if len(text) < BLOCK_BYTES:  # the end of the file also ends a line
            end = len(text)
        elif not end:
            raise ScanDamagedError(
                f"Line {self._next_line:,} is longer than {BLOCK_BYTES:,} bytes; expected one point per line. "
                "The file is damaged or not a text scan."
            )
        self._rest = text[end:]
        return text[:end]

    def _split(self, text: bytes) -> TextBlock:
        if b"\r" in text:
            text = text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        if not text.endswith(b"\n"):
            text += b"\n"
        text = text.translate(self._table)
        codes = np.frombuffer(text, np.uint8)
        ends = np.flatnonzero(codes == _NEWLINE) + 1
        begins = np.concatenate([[0], ends[:-1]])
        is_space = _WHITESPACE[codes]
        is_value_start = ~is_space
        is_value_start[1:] &= is_space[:-1]
        num_values = np.add.reduceat(is_value_start, begins, dtype=np.int64)
        numbers = np.arange(self._next_line, self._next_line + len(ends))
        self._next_line += len(ends)
        filled = num_values > 0
        return TextBlock(text, begins[filled], ends[filled], num_values[filled], numbers[filled], self._stream.tell())


def substitutions(separators: bytes = b"", decimal_comma: bool = False) -> bytes:
    """Return the table for `bytes.translate` that leaves numbers parted by spaces alone."""
    spaces = b"\t\v\f" + separators
    return bytes.maketrans(spaces + b"," * decimal_comma, b" " * len(spaces) + b"." * decimal_comma)


def is_number(word: str | bytes) -> bool:
    """Tell whether a word is a number as text files write it."""
    try:
        float(word)
    except ValueError:
        return False
    return not isinstance(word, bytes) or b"_" not in word


def parse_numbers(text: bytes) -> NDArray[np.float64] | None:
    """Parse numbers parted by white space; None when something else is among them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # how numpy before 2.3 reports text that is no number
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None
