"""Check the chunk table of a LAZ file: the decompressor allocates the sizes in it without asking."""

import struct
from typing import BinaryIO

from core.errors import CUT_SHORT, ScanDamagedError

_VARIABLE_CHUNKS = 0xFFFFFFFF
_MAX_CHUNK_BYTES = 1 << 28
# Layers of the items of LAS 1.4 records (laszip: POINT14, RGB14, RGBNIR14, WAVEPACKET14); BYTE14 has one per byte.
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
_BYTE14 = 14
_ITEM = struct.Struct("<HHH")


class LazChunks:
    """The chunks of a LAZ file. description: the laszip record of the header. num_points, record_bytes: as announced.

    offset: where the point data begins. Methods raise ScanDamagedError for sizes that contradict each other.
    """

    def __init__(self, description: bytes, num_points: int, record_bytes: int, offset: int):
        num_items = int.from_bytes(description[32:34], "little") if len(description) >= 34 else 0
        if not num_items or len(description) < 34 + num_items * _ITEM.size:
            raise ScanDamagedError("The LAZ file does not describe its compression. Export the scan again.")
        self._items = [_ITEM.unpack_from(description, 34 + _ITEM.size * number) for number in range(num_items)]
        self._description = description
        self._chunk_points = int.from_bytes(description[12:16], "little")
        self._num_points, self._record_bytes, self._offset = num_points, record_bytes, offset
        too_large = not 0 < self._chunk_points * record_bytes <= _MAX_CHUNK_BYTES
        if sum(size for _, size, _ in self._items) != record_bytes or (too_large and not self._is_variable):
            raise ScanDamagedError(
                f"The LAZ file announces chunks of {self._chunk_points:,} points of {record_bytes} bytes, which "
                "contradicts the rest of its header. Export the scan again."
            )

    def check(self, stream: BinaryIO, size_bytes: int) -> None:
        """Check every size that will be allocated; `size_bytes` is the size of the whole file."""
        start = self._table_start(stream, size_bytes)
        stream.seek(start)
        _, num_chunks = struct.unpack("<II", stream.read(8))
        data_bytes = start - self._offset - 8
        fewest = 1 if self._is_variable else -(-self._num_points // self._chunk_points)
        most = data_bytes // self._record_bytes  # each chunk begins with a whole point
        if not fewest <= num_chunks <= (most if self._is_variable else min(fewest, most)):
            raise self._error(f"there are {num_chunks:,} chunks; expected {fewest:,}")
        self._check_chunks(stream, data_bytes)

    @property
    def _is_variable(self) -> bool:
        return self._chunk_points == _VARIABLE_CHUNKS

    def _table_start(self, stream: BinaryIO, size_bytes: int) -> int:
        stream.seek(self._offset)
        start = int.from_bytes(stream.read(8), "little", signed=True)
        if start == -1:  # written by a streaming writer: the last eight bytes say where the table is
            stream.seek(max(size_bytes - 8, 0))
            start = int.from_bytes(stream.read(8), "little", signed=True)
        if not self._offset + 8 <= start <= size_bytes - 8:
            raise self._error(f"their chunk table should lie at byte {start:,} of {size_bytes:,}")
        return start

    def _check_chunks(self, stream: BinaryIO, data_bytes: int) -> None:
        import lazrs  # type: ignore[import-untyped]  # it ships no types

        stream.seek(self._offset)
        try:
            table = lazrs.read_chunk_table(stream, lazrs.LazVlr(self._description))
        except Exception as error:
            raise self._error(f"their chunk table cannot be read ({error})") from error
        num_points, num_bytes = sum(points for points, _ in table), sum(size for _, size in table)
        largest = max((points for points, _ in table), default=0)
        if num_points < self._num_points or num_bytes > data_bytes or largest * self._record_bytes > _MAX_CHUNK_BYTES:
            raise self._error(
                f"their chunks announce {num_points:,} points in {num_bytes:,} bytes of the {data_bytes:,} there are"
            )
        self._check_layers(stream, [size for _, size in table])

    def _check_layers(self, stream: BinaryIO, chunk_sizes: list[int]) -> None:
        """LAS 1.4 chunks hold the first point, its count, and a size for each layer that follows."""
        num_layers = sum(size if kind == _BYTE14 else _LAYERS.get(kind, 0) for kind, size, _ in self._items)
        if not num_layers:
            return
        start = self._offset + 8
        sizes = struct.Struct(f"<4x{num_layers}I")
        for number, chunk_bytes in enumerate(chunk_sizes):
            stream.seek(start + self._record_bytes)
            data = stream.read(sizes.size)
            needed = self._record_bytes + sizes.size
            if len(data) < sizes.size or needed + sum(sizes.unpack(data)) > chunk_bytes:
                raise self._error(f"chunk {number:,} announces more than its {chunk_bytes:,} bytes")
            start += chunk_bytes

    def _error(self, what: str) -> ScanDamagedError:
        return ScanDamagedError(f"The LAZ header announces {self._num_points:,} points, but {what}. {CUT_SHORT}")
