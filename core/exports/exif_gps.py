"""The GPS position in the EXIF data of a JPEG: replaced as a whole, while all other bytes stay where they are.

Maker notes have offsets of their own, so nothing is moved: a new table is appended, and entries point to it (TIFF 6.0, Exif 2.32).
"""

import struct
from dataclasses import dataclass

_SIGNATURE = b"Exif\x00\x00"
_GPS_POINTER, _ENTRY_BYTES, _COUNT_BYTES = 0x8825, 12, 2
_BYTE, _ASCII, _LONG, _RATIONAL = 1, 2, 4, 5
_TIME_STAMP, _DATE_STAMP = 0x07, 0x1D
_SIZES = {_BYTE: 1, _ASCII: 1, 3: 2, _LONG: 4, _RATIONAL: 8}
_FINEST = 1_000_000  # parts of a second of arc: 0.03 mm
_THUMBNAIL = (0x0201, 0x0202)
_ORDERS = {b"II": "<", b"MM": ">"}
MAX_SEGMENT_BYTES = 65_533
"""Of a segment of a JPEG, without its marker and length."""
_EMPTY = b"II*\x00\x08\x00\x00\x00" + bytes(6)  # a header, and a table without entries

Field = tuple[int, int, int, bytes]


@dataclass(frozen=True)
class GpsPosition:
    """WGS 84 in degrees; height above sea level in metres, None where unknown; compass heading in degrees."""

    latitude_deg: float
    longitude_deg: float
    height_m: float | None
    heading_deg: float


def with_position(segment: bytes | None, position: GpsPosition) -> bytes:
    """Return an EXIF segment, without its marker and length, with this position in place of its own.

    segment: the former one, None without. Of its position only date and time stay. What is no EXIF is replaced. A segment has 64 KiB: where
    there is no room, the thumbnail goes, and else the former position alone.
    """
    try:
        tiff = bytearray(segment.removeprefix(_SIGNATURE) if segment else _EMPTY)
        order = _ORDERS[bytes(tiff[:2])]
        kept = _taken_out(tiff, order)
    except (struct.error, KeyError):
        tiff, order, kept = bytearray(_EMPTY), _ORDERS[_EMPTY[:2]], []
    for before in (tiff, _without_thumbnail(tiff, order)):
        changed = _SIGNATURE + _added(bytearray(before), order, [*_fields(order, position), *kept])
        if len(changed) <= MAX_SEGMENT_BYTES:
            return changed
    return _SIGNATURE + bytes(tiff)


def is_exif(segment: bytes) -> bool:
    """Tell whether an APP1 segment, without its marker and length, is EXIF."""
    return segment.startswith(_SIGNATURE)


def _taken_out(tiff: bytearray, order: str) -> list[Field]:
    """Overwrite the former position: nobody shall find it in the file. Return when it was taken: photos lack universal time otherwise."""
    entries, _ = _table(tiff, order, _first(tiff, order))
    at = next((struct.unpack_from(order + "I", entry, 8)[0] for tag, entry in entries if tag == _GPS_POINTER), None)
    try:
        of_position = [] if at is None else _table(tiff, order, at)[0]
    except struct.error:  # damaged; the rest may be whole
        return []
    values = [(tag, *_value(tiff, order, entry)) for tag, entry in of_position]
    for _, _, _, value, value_at in values:
        if value_at is not None:
            tiff[value_at : value_at + len(value)] = bytes(len(value))
    if at is not None:
        end = at + _COUNT_BYTES + len(of_position) * _ENTRY_BYTES
        tiff[at:end] = bytes(end - at)
    return [(tag, kind, count, value) for tag, kind, count, value, _ in values if tag in (_TIME_STAMP, _DATE_STAMP)]


def _without_thumbnail(tiff: bytearray, order: str) -> bytearray:
    """Return EXIF data without its second table, and without the picture of that where it is the last."""
    first = _first(tiff, order)
    entries, second = _table(tiff, order, first)
    tags = dict(_table(tiff, order, second)[0]) if second else {}
    begin, size = (struct.unpack_from(order + "I", tags.get(tag, bytes(12)), 8)[0] for tag in _THUMBNAIL)
    shorter = bytearray(tiff)
    struct.pack_into(order + "I", shorter, first + _COUNT_BYTES + len(entries) * _ENTRY_BYTES, 0)
    return shorter[:begin] if begin and begin + size + 4 >= len(tiff) else shorter


def _added(tiff: bytearray, order: str, fields: list[Field]) -> bytes:
    first = _first(tiff, order)
    entries, next_table = _table(tiff, order, first)
    tiff += bytes(len(tiff) % 2)
    pointer = struct.pack(order + "HHII", _GPS_POINTER, _LONG, 1, len(tiff))
    tiff += _written(order, len(tiff), fields)
    tags = [tag for tag, _ in entries]
    if _GPS_POINTER in tags:
        at = first + _COUNT_BYTES + tags.index(_GPS_POINTER) * _ENTRY_BYTES
        tiff[at : at + _ENTRY_BYTES] = pointer
        return bytes(tiff)
    # The first table grows by an entry, at a new place: its values stay where they are.
    rows = sorted([*entries, (_GPS_POINTER, pointer)])
    struct.pack_into(order + "I", tiff, 4, len(tiff))
    tiff += (
        struct.pack(order + "H", len(rows)) + b"".join(row for _, row in rows) + struct.pack(order + "I", next_table)
    )
    return bytes(tiff)


def _first(tiff: bytearray, order: str) -> int:
    return int(struct.unpack_from(order + "I", tiff, 4)[0])


def _table(tiff: bytearray, order: str, at: int) -> tuple[list[tuple[int, bytes]], int]:
    """Return tag and bytes of each entry of a table, and where the next table is."""
    count = struct.unpack_from(order + "H", tiff, at)[0]
    begins = [at + _COUNT_BYTES + number * _ENTRY_BYTES for number in range(count)]
    entries = [
        (struct.unpack_from(order + "H", tiff, begin)[0], bytes(tiff[begin : begin + _ENTRY_BYTES])) for begin in begins
    ]
    return entries, struct.unpack_from(order + "I", tiff, at + _COUNT_BYTES + count * _ENTRY_BYTES)[0]


def _value(tiff: bytearray, order: str, entry: bytes) -> tuple[int, int, bytes, int | None]:
    """Return kind, count and bytes of an entry's value, and where it lies if not in the entry."""
    _, kind, count = struct.unpack_from(order + "HHI", entry)
    size = _SIZES.get(kind, 1) * count
    if size <= 4:
        return kind, count, entry[8 : 8 + size], None
    at = struct.unpack_from(order + "I", entry, 8)[0]
    return kind, count, bytes(tiff[at : at + size]), at


def _fields(order: str, position: GpsPosition) -> list[Field]:
    """Return tag, kind, count and bytes of each field."""
    fields = [(0x00, _BYTE, 4, bytes([2, 3, 0, 0]))]
    for tag, degrees, signs in ((0x01, position.latitude_deg, b"NS"), (0x03, position.longitude_deg, b"EW")):
        parts = round(abs(degrees) * 3600 * _FINEST)
        minutes, seconds = divmod(parts, 60 * _FINEST)
        angle = (minutes // 60, 1, minutes % 60, 1, seconds, _FINEST)
        fields.append((tag, _ASCII, 2, bytes([signs[degrees < 0], 0])))
        fields.append((tag + 1, _RATIONAL, 3, struct.pack(order + "6I", *angle)))
    if position.height_m is not None:
        fields.append((0x05, _BYTE, 1, bytes([position.height_m < 0])))
        fields.append((0x06, _RATIONAL, 1, struct.pack(order + "2I", round(abs(position.height_m) * 1000), 1000)))
    fields.append((0x10, _ASCII, 2, b"T\x00"))
    fields.append((0x11, _RATIONAL, 1, struct.pack(order + "2I", round(position.heading_deg * 1000) % 360_000, 1000)))
    return [*fields, (0x12, _ASCII, 7, b"WGS-84\x00")]


def _written(order: str, at: int, fields: list[Field]) -> bytes:
    """Return a table that lies at this place, with its values behind it."""
    rows, values = b"", b""
    values_at = at + _COUNT_BYTES + len(fields) * _ENTRY_BYTES + 4
    for tag, kind, count, value in sorted(fields):
        rows += struct.pack(order + "HHI", tag, kind, count)
        if len(value) <= 4:
            rows += value.ljust(4, b"\x00")
        else:
            rows += struct.pack(order + "I", values_at + len(values))
            values += value + bytes(len(value) % 2)
    return struct.pack(order + "H", len(fields)) + rows + bytes(4) + values
