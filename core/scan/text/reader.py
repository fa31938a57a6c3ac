"""Read scans that are tables of numbers: XYZ, TXT, CSV, ASC and PTS."""

from collections.abc import Iterator

import numpy as np

from panoloc.core.errors import CUT_SHORT, ScanDamagedError
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext
from panoloc.core.scan.text.layout import HEAD_BYTES, TextLayout, choose_columns, detect_layout
from panoloc.core.scan.text.table import TextBlock, TextLines

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_COMMENT_CODES = tuple(b"#/")


def read_text(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a text scan in chunks; colours are float64 in the file's range.

    Raises ScanFormatError when there is no table of numbers, ScanDamagedError when a line does not fit or fewer points
    come than a first line announces, ScanContentError without colour.
    """
    with context.path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
        mark_bytes = len(_BYTE_ORDER_MARK) if head.startswith(_BYTE_ORDER_MARK) else 0
        layout = detect_layout(head[mark_bytes:])
        if layout.announced is not None:
            context.check_point_count(layout.announced)
        stream.seek(mark_bytes + layout.first_row)
        lines = TextLines(stream, layout.first_line, layout.separators, layout.decimal_comma)
        yield from _iter_chunks(context, layout, lines)


def _iter_chunks(context: ReadingContext, layout: TextLayout, lines: TextLines) -> Iterator[RawChunk]:
    announced, num_done = layout.announced, 0
    columns: list[int] = []
    while (block := lines.take(CHUNK_ROWS)) is not None:
        block = block.drop_lines(_is_comment(block))
        if announced is not None:
            is_count = block.num_values == 1
            announced += sum(_parse_count(block, row) for row in np.flatnonzero(is_count).tolist())
            block = block.drop_lines(is_count)
        if not len(block):
            continue
        table = block.to_table(layout.num_columns)
        if not columns:
            is_pts = announced is not None or _extension(context) == "pts"
            columns, found = choose_columns(layout, table, is_pts)
            if layout.num_columns > 6:
                context.note("columns_chosen", f"The colour columns were determined {found}.")
        num_done += len(table)
        yield RawChunk(table[:, columns[:3]], table[:, columns[3:]], block.end_offset / context.size_bytes)
    if announced is not None and num_done < announced:
        raise ScanDamagedError(f"The file announces {announced:,} points, but holds {num_done:,}. {CUT_SHORT}")


def _is_comment(block: TextBlock) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
    first_bytes = np.frombuffer(block.text, np.uint8)[block.begins]
    return np.isin(first_bytes, _COMMENT_CODES)


def _parse_count(block: TextBlock, row: int) -> int:
    word = block.line(row)
    if not word.isdigit() or len(word) >= 20:
        raise ScanDamagedError(
            f"Line {block.numbers[row]:,} has the single value {word[:40].decode(errors='replace')!r}; expected a "
            "point, or the number of points below. Export the scan again."
        )
    return int(word)


def _extension(context: ReadingContext) -> str:
    return (context.path.suffix or context.options.format or "").lower().lstrip(".")
