"""Read LAS and LAZ scans with laspy."""

from collections.abc import Iterator

import numpy as np

from core.errors import CUT_SHORT, ScanDamagedError
from core.scan.las.coordinate_system import coordinate_system_of
from core.scan.las.header import check_las_header
from core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, stack_columns


def read_las(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a LAS or LAZ file in chunks; colours are uint16.

    Raises ScanDamagedError when the file is shorter than its header says or does not decompress, ScanContentError
    without colour.
    """
    with context.path.open("rb") as stream:
        layout = check_las_header(stream, context)
        context.coordinate_system = coordinate_system_of(stream)
    num_done = 0
    chunks = _iter_chunks(context)
    while True:
        try:
            chunk = next(chunks, None)
        except Exception as error:
            raise _unreadable_error(error, num_done, layout.num_points) from error
        except BaseException as error:
            # The Rust decompressor panics on some damaged data; its exception is no Exception.
            if type(error).__name__ != "PanicException":
                raise
            raise _unreadable_error(error, num_done, layout.num_points) from None
        if chunk is None:
            break
        num_done += len(chunk.positions)
        yield RawChunk(chunk.positions, chunk.colors, num_done / layout.num_points)
    if num_done < layout.num_points:
        raise _unreadable_error(None, num_done, layout.num_points)


def _iter_chunks(context: ReadingContext) -> Iterator[RawChunk]:
    import laspy

    # The parallel decompressor allocates what a damaged chunk table announces; the serial one does not.
    backend = laspy.LazBackend.Lazrs
    with laspy.open(context.path, laz_backend=backend, read_evlrs=False) as reader:
        for points in reader.chunk_iterator(CHUNK_ROWS):
            with np.errstate(over="ignore", invalid="ignore"):
                positions = np.stack([np.asarray(points[axis], np.float64) for axis in "xyz"], axis=1)
            yield RawChunk(positions, stack_columns(points.array, ("red", "green", "blue"), np.uint16), 0.0)


def _unreadable_error(error: BaseException | None, num_done: int, num_points: int) -> ScanDamagedError:
    reason = f" ({str(error).strip().splitlines()[0][:200]})" if error is not None and str(error).strip() else ""
    return ScanDamagedError(
        f"The LAS header announces {num_points:,} points, but after {num_done:,} the data cannot be read{reason}. "
        f"{CUT_SHORT}"
    )
