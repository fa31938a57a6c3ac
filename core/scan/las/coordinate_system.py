"""The coordinate system that a LAS file names in its records: WKT, or the keys of GeoTIFF."""

import io
import struct
from typing import BinaryIO

_USER = b"LASF_Projection"
_WKT_RECORD, _KEYS_RECORD = 2112, 34735
_VLR_BYTES, _EVLR_BYTES = 54, 60
_LONGEST = 1 << 20
# Keys of GeoTIFF: what stands in the directory itself has the location 0.
_PROJECTED_KEY, _VERTICAL_KEY = 3072, 4096
_CODES = range(1024, 32767)


def coordinate_system_of(stream: BinaryIO) -> str | None:
    """Return WKT or "EPSG:…" of a LAS file whose header is checked; None where it says nothing."""
    stream.seek(0)
    header = stream.read(375)
    header_bytes, _, num_records = struct.unpack_from("<HII", header, 94)
    records = _records(stream, header_bytes, num_records, _VLR_BYTES)
    if header[25] == 4 and len(header) == 375:
        start, num_extended = struct.unpack_from("<QI", header, 235)
        records |= _records(stream, start, num_extended, _EVLR_BYTES)
    wkt = records.get(_WKT_RECORD, b"").split(b"\0", 1)[0].decode("utf-8", "replace").strip()
    return wkt or _by_keys(records.get(_KEYS_RECORD, b""))


def _records(stream: BinaryIO, start: int, count: int, header_bytes: int) -> dict[int, bytes]:
    """Return the records about coordinate systems by number; the rest is passed over, and what is cut short ends the list."""
    found: dict[int, bytes] = {}
    layout = "<2x16sHH" if header_bytes == _VLR_BYTES else "<2x16sHQ"
    position, size = start, stream.seek(0, io.SEEK_END)
    for _ in range(min(count, 1000)):
        if position > size:
            break
        stream.seek(position)
        head = stream.read(header_bytes)
        if len(head) < header_bytes:
            break
        user, number, length = struct.unpack_from(layout, head)
        if user.rstrip(b"\0") == _USER and number in (_WKT_RECORD, _KEYS_RECORD) and length <= _LONGEST:
            found.setdefault(number, stream.read(length))
        position += header_bytes + length
    return found


def _by_keys(directory: bytes) -> str | None:
    values = struct.unpack(f"<{len(directory) // 2}H", directory[: len(directory) // 2 * 2])
    keys = {values[at]: values[at + 3] for at in range(4, len(values) - 3, 4) if values[at + 1] == 0}
    projected, vertical = keys.get(_PROJECTED_KEY, 0), keys.get(_VERTICAL_KEY, 0)
    if projected not in _CODES:
        return None
    return f"EPSG:{projected}+{vertical}" if vertical in _CODES else f"EPSG:{projected}"
