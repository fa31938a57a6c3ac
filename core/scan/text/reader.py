"""Read scans that are tables of numbers: XYZ, TXT, CSV, ASC and PTS. Their first lines say how they are laid out."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanDamagedError, ScanFormatError
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error
from panoloc.core.scan.text.table import TextBlock, TextLines, is_number, substitutions

_HEAD_BYTES = 1 << 16
_MAX_LEADING_LINES = 100
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_COMMENT_STARTS = (b"#", b"//")
_COMMENT_CODES = tuple(b"#/")
_COLUMN_NAMES = {
    "x": ("x", "px", "pos_x"),
    "y": ("y", "py", "pos_y"),
    "z": ("z", "pz", "pos_z"),
    "red": ("r", "red", "rf", "diffuse_red"),
    "green": ("g", "green", "gf", "diffuse_green"),
    "blue": ("b", "blue", "bf", "diffuse_blue"),
}
_LARGEST_COLOR = 65535


@dataclass(frozen=True)
class TextLayout:
    """How to read the lines of a text scan.

    table: of bytes that part values, as `substitutions` returns it. first_row: bytes before the first line of numbers;
    first_line: its number. names: column names of a header line. announced: point count of a first line.
    """

    table: bytes
    first_row: int
    first_line: int
    num_columns: int
    names: tuple[str, ...] = ()
    announced: int | None = None


def read_text(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a text scan in chunks; colours are float64 in the file's range.

    Raises ScanFormatError when there is no table of numbers, ScanDamagedError when a line does not fit or fewer points
    come than a first line announces, ScanContentError without colour.
    """
    with context.path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
        mark_bytes = len(_BYTE_ORDER_MARK) if head.startswith(_BYTE_ORDER_MARK) else 0
        layout = detect_layout(head[mark_bytes:])
        if layout.announced is not None:
            context.check_point_count(layout.announced)
        stream.seek(mark_bytes + layout.first_row)
        lines = TextLines(stream, layout.first_line, layout.table)
        yield from _iter_chunks(context, layout, lines)


def detect_layout(head: bytes) -> TextLayout:
    """Return the layout of a text whose first bytes are `head`; raise ScanFormatError when it is no table of points."""
    names: tuple[str, ...] = ()
    announced: int | None = None
    position = 0
    for number, line in enumerate(re.split(rb"(?<=\n)|(?<=\r)(?!\n)", head), start=1):
        if number > _MAX_LEADING_LINES:
            break
        table = substitutions(*_separators(line))
        words = line.translate(table).split()
        if len(words) == 1 and words[0].isdigit() and len(words[0]) < 20:
            announced = (announced or 0) + int(words[0])
        elif len(words) >= 3 and all(is_number(word) for word in words) and not line.startswith(_COMMENT_STARTS):
            columns = names if len(names) == len(words) else ()
            return TextLayout(table, position, number, len(words), columns, announced)
        elif words:
            names = _header_names(line) or names
        position += len(line)
    first = head.split(b"\n", 1)[0][:60].decode("utf-8", errors="replace")
    raise ScanFormatError(
        f"The file is text, but no line of its first {_MAX_LEADING_LINES} holds three or more numbers (it begins with "
        f"{first!r}). Expected one point per line: x y z red green blue."
    )


def _iter_chunks(context: ReadingContext, layout: TextLayout, lines: TextLines) -> Iterator[RawChunk]:
    announced, num_done = layout.announced, 0
    columns: list[int] = []
    while (block := lines.take(CHUNK_ROWS)) is not None:
        first_bytes = np.frombuffer(block.text, np.uint8)[block.begins]
        block = block.without(np.isin(first_bytes, _COMMENT_CODES))
        if announced is not None:
            is_count = block.num_values == 1
            announced += sum(_parse_count(block, row) for row in np.flatnonzero(is_count).tolist())
            block = block.without(is_count)
        if not len(block):
            continue
        table = block.to_table(layout.num_columns)
        if not columns:
            extension = (context.path.suffix or context.options.format or "").lower().lstrip(".")
            is_pts = announced is not None or extension == "pts"
            columns, found = _choose_columns(layout, table, is_pts)
            if layout.num_columns > 6:
                context.note("columns_chosen", f"The colour columns were determined {found}.")
        num_done += len(table)
        yield RawChunk(table[:, columns[:3]], table[:, columns[3:]], block.end_offset / context.size_bytes)
    if announced is not None and num_done < announced:
        raise ScanDamagedError(f"The file announces {announced:,} points, but holds {num_done:,}. {CUT_SHORT}")


def _parse_count(block: TextBlock, row: int) -> int:
    word = block.line(row)
    if not word.isdigit() or len(word) >= 20:
        raise ScanDamagedError(
            f"Line {block.numbers[row]:,} has the single value {word[:40].decode(errors='replace')!r}; expected a "
            "point, or the number of points below. Export the scan again."
        )
    return int(word)


def _choose_columns(layout: TextLayout, sample: NDArray[np.float64], is_pts: bool) -> tuple[list[int], str]:
    """Return the columns of x, y, z, red, green, blue, and how they were found.

    sample: the first rows, (n, num_columns). is_pts: colour follows an intensity. Raises ScanContentError without
    colour.
    """
    if layout.names:
        return _named_columns(layout.names), f"by the header line {' '.join(layout.names)[:200]}"
    if layout.num_columns < 6:
        raise no_color_error(f"{layout.num_columns} columns; expected x y z red green blue")
    starts = (*((4, 3) if is_pts else (3, 4)), 6, layout.num_columns - 3)
    for start in starts:
        if start + 3 <= layout.num_columns and _looks_like_color(sample[:, start : start + 3]):
            return [0, 1, 2, start, start + 1, start + 2], f"by their values (columns {start + 1} to {start + 3})"
    raise no_color_error(
        f"{layout.num_columns} columns, and none looks like colours of 0..1 or 0..255; name the columns in a header "
        "line"
    )


def _named_columns(names: Sequence[str]) -> list[int]:
    columns = []
    for meaning, spellings in _COLUMN_NAMES.items():
        found = [number for number, name in enumerate(names) if name in spellings]
        if not found and meaning in ("x", "y", "z"):
            raise ScanFormatError(f"The header line names the columns {' '.join(names)[:200]}, but none is {meaning}.")
        if not found:
            raise no_color_error(f"the columns {' '.join(names)[:200]}")
        if len(found) > 1:
            raise ScanFormatError(f"The header line names {len(found)} columns {meaning}: {' '.join(names)[:200]}.")
        columns.append(found[0])
    return columns


def _looks_like_color(columns: NDArray[np.float64]) -> bool:
    values = columns[np.isfinite(columns).all(axis=1)]
    if not len(values) or values.min() < 0 or values.max() > _LARGEST_COLOR:
        return False
    return bool(values.max() <= 1.01 or np.array_equal(values, np.rint(values)) or values.max() <= 255)


def _separators(line: bytes) -> tuple[bytes, bool]:
    """Return the separators of a line, and whether a comma is its decimal point."""
    if b";" in line:
        return b';"', b"," in line and b"." not in line
    if b"," not in line:
        return b'"', False
    words = line.split()
    is_decimal = b"." not in line and len(words) >= 3 and all(re.fullmatch(rb"[-+]?\d+(,\d+)?", word) for word in words)
    return (b'"', True) if is_decimal else (b',"', False)


def _header_names(line: bytes) -> tuple[str, ...]:
    """Return the lower-case column names of a header line such as `//X,Y,Z,R,G,B`, or nothing for other lines."""
    text = line.decode("utf-8", errors="replace").lstrip("\ufeff#/ \t").lower()
    words = [re.sub(r"[\[(].*", "", word).strip("\"'") for word in re.split(r"[\s,;]+", text) if word]
    return tuple(words) if {"x", "y", "z"} <= set(words) else ()
