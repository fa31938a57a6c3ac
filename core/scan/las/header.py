"""Check a LAS or LAZ file before a library allocates what its header announces."""

import struct
from dataclasses import dataclass
from typing import BinaryIO

from core.errors import CUT_SHORT, ScanDamagedError
from core.scan.las.laz_chunks import LazChunks
from core.scan.reading_context import ReadingContext, no_color_error

# Size of a record without extra bytes by point format (ASPRS LAS 1.4 R15).
_RECORD_BYTES = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}
_COLORED_FORMATS = {2, 3, 5, 7, 8, 10}
_MIN_HEADER_BYTES = 227
_HEADER_BYTES_1_4 = 375
_VLR_BYTES, _EVLR_BYTES = 54, 60
_LASZIP_RECORD = 22204
_LASZIP_USER = b"laszip encoded"


@dataclass(frozen=True)
class LasLayout:
    """What the public header says."""

    num_points: int
    record_bytes: int
    is_compressed: bool


def check_las_header(stream: BinaryIO, context: ReadingContext) -> LasLayout:
    """Return the layout of the file; raise ScanDamagedError or ScanContentError when it cannot be read."""
    size_bytes = context.size_bytes
    header = stream.read(_HEADER_BYTES_1_4)
    if len(header) < _MIN_HEADER_BYTES:
        raise ScanDamagedError(
            f"The LAS file has {len(header)} bytes; its header alone takes {_MIN_HEADER_BYTES}. {CUT_SHORT}"
        )
    major, minor = header[24], header[25]
    header_bytes, offset, num_vlrs, format_byte, record_bytes, num_points = struct.unpack_from("<HIIBHI", header, 94)
    if major != 1 or minor > 4:
        raise ScanDamagedError(f"The LAS file has the version {major}.{minor}; expected 1.0 to 1.4.")
    if minor == 4 and len(header) == _HEADER_BYTES_1_4:
        evlr_start, num_evlrs, num_points = struct.unpack_from("<QIQ", header, 235)
        _check_inside("extended records", evlr_start + num_evlrs * _EVLR_BYTES if num_evlrs else 0, size_bytes)
    is_compressed, point_format = format_byte & 0xC0 != 0, format_byte & 0x3F
    if point_format not in _RECORD_BYTES or record_bytes < _RECORD_BYTES[point_format]:
        raise ScanDamagedError(
            f"The LAS header announces point format {point_format} with {record_bytes} bytes per point; "
            f"expected a format from 0 to 10 with at least {_RECORD_BYTES.get(point_format, 20)} bytes. "
            "Export the scan again."
        )
    if point_format not in _COLORED_FORMATS:
        raise no_color_error(f"LAS point format {point_format}; formats 2, 3, 5, 7, 8 and 10 have colour")
    if header_bytes < _MIN_HEADER_BYTES or header_bytes + num_vlrs * _VLR_BYTES > offset:
        raise ScanDamagedError(
            f"The LAS header contradicts itself: {header_bytes} bytes of header and {num_vlrs:,} records do not fit "
            f"before the points at byte {offset:,}. Export the scan again."
        )
    context.check_point_count(num_points)
    _check_inside("points", offset, size_bytes)
    layout = LasLayout(num_points, record_bytes, is_compressed)
    if is_compressed:
        description = _laszip_description(stream, header_bytes, num_vlrs, offset)
        LazChunks(description, num_points, record_bytes, offset).check(stream, size_bytes)
    elif offset + num_points * record_bytes > size_bytes:
        raise ScanDamagedError(
            f"The LAS header announces {num_points:,} points of {record_bytes} bytes, but the file holds "
            f"{size_bytes - offset:,} bytes of them, enough for {(size_bytes - offset) // record_bytes:,}. {CUT_SHORT}"
        )
    return layout


def _check_inside(what: str, position: int, size_bytes: int) -> None:
    if position > size_bytes:
        raise ScanDamagedError(
            f"The LAS header places its {what} at byte {position:,}, but the file has {size_bytes:,}. {CUT_SHORT}"
        )


def _laszip_description(stream: BinaryIO, header_bytes: int, num_vlrs: int, offset: int) -> bytes:
    position = header_bytes
    for _ in range(num_vlrs):
        stream.seek(position)
        record = stream.read(_VLR_BYTES)
        if len(record) < _VLR_BYTES or position > offset:
            break
        record_id, length = struct.unpack_from("<HH", record, 18)
        if record_id == _LASZIP_RECORD and record[2:18].rstrip(b"\0") == _LASZIP_USER:
            return stream.read(length)
        position += _VLR_BYTES + length
    raise ScanDamagedError("The LAZ file has no record that describes its compression. Export the scan again.")
