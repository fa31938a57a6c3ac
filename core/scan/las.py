"""Read LAS, LAZ and COPC scans with laspy, always in the sandbox: a damaged file makes the decompressor allocate gigabytes."""

import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from panoloc.core.errors import CUT_SHORT, ScanDamagedError, ScanError
from panoloc.core.options import Unit
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error, stack_columns

_COLORS = ("red", "green", "blue")
# GeoTIFF keys; a key that holds its value in the directory itself has the location 0.
_PROJECTED_KEY, _VERTICAL_KEY = 3072, 4096
_UNIT_KEY, _VERTICAL_UNIT_KEY = 3076, 4099
_UNITS: dict[int, Unit] = {9001: "m", 9002: "ft", 9003: "us-ft"}
_EPSG_CODES = range(1024, 32767)
_RECORD_BYTES, _EXTENDED_RECORD_BYTES = 54, 60
_MAX_EXTENDED_BYTES = 1 << 28


def read_las(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield the points of a LAS or LAZ file in chunks; colours are uint16.

    Raises ScanDamagedError when the file is shorter than its header says or does not decompress, ScanContentError
    without colour.
    """
    reads_extended = _check_records(context)
    num_done, num_points = 0, 0
    try:
        import laspy

        # The serial decompressor: the parallel one allocates what a damaged chunk table announces.
        with laspy.open(context.path, laz_backend=laspy.LazBackend.Lazrs, read_evlrs=reads_extended) as reader:
            num_points, kind = reader.header.point_count, reader.header.point_format
            context.check_point_count(num_points)
            if not set(_COLORS) <= set(kind.dimension_names):
                raise no_color_error(f"LAS point format {kind.id}; formats 2, 3, 5, 7, 8 and 10 have colour")
            context.coordinate_system, context.unit, context.height_unit = _coordinate_system(reader.header)
            for points in reader.chunk_iterator(CHUNK_ROWS):
                with np.errstate(over="ignore", invalid="ignore"):
                    positions = np.stack([np.asarray(points[axis], np.float64) for axis in "xyz"], axis=1)
                num_done += len(positions)
                yield RawChunk(positions, stack_columns(points.array, _COLORS, np.uint16), num_done / num_points)
    except (ScanError, MemoryError, GeneratorExit):
        raise
    except BaseException as error:  # the Rust decompressor panics on some damaged data; its exception is no Exception
        reason = (str(error).strip().splitlines() or ["unknown error"])[0][:200]
        raise _unreadable_error(reason, num_done, num_points) from error
    if num_done < num_points:
        raise _unreadable_error("the file ends", num_done, num_points)


def _check_records(context: ReadingContext) -> bool:
    """Refuse record counts that the file cannot hold: laspy would walk billions of them until the sandbox ends it.

    Returns whether the extended records, which may hold gigabytes of waveforms, are small enough to be read.
    """
    with context.path.open("rb") as stream:
        header = stream.read(375).ljust(375, b"\0")
    (num_records,), (num_extended,) = struct.unpack_from("<I", header, 100), struct.unpack_from("<I", header, 243)
    num_extended = num_extended if header[25] == 4 else 0
    if num_records * _RECORD_BYTES + num_extended * _EXTENDED_RECORD_BYTES > context.size_bytes:
        raise ScanDamagedError(
            f"The LAS header announces {num_records + num_extended:,} records, more than fit into the "
            f"{context.size_bytes:,} bytes of the file. {CUT_SHORT}"
        )
    (extended_start,) = struct.unpack_from("<Q", header, 235)
    return context.size_bytes - int(extended_start) <= _MAX_EXTENDED_BYTES


def _coordinate_system(header: Any) -> tuple[str | None, Unit | None, Unit | None]:
    """Return WKT or "EPSG:…", unit and unit of heights from the records of the file, None where it says nothing."""
    from laspy.vlrs.known import GeoKeyDirectoryVlr, WktCoordinateSystemVlr

    records = [*header.vlrs, *(header.evlrs or ())]
    wkt = next((each.string.strip("\0 \n") for each in records if isinstance(each, WktCoordinateSystemVlr)), "")
    directories = [each.geo_keys for each in records if isinstance(each, GeoKeyDirectoryVlr)]
    keys = {key.id: key.value_offset for found in directories for key in found if key.tiff_tag_location == 0}
    projected, vertical = keys.get(_PROJECTED_KEY, 0), keys.get(_VERTICAL_KEY, 0)
    if wkt:
        return wkt, None, None
    system = f"EPSG:{projected}" if projected in _EPSG_CODES else None
    if system and vertical in _EPSG_CODES:
        system = f"{system}+{vertical}"
    return system, _UNITS.get(keys.get(_UNIT_KEY, 0)), _UNITS.get(keys.get(_VERTICAL_UNIT_KEY, 0))


def _unreadable_error(reason: str, num_done: int, num_points: int) -> ScanDamagedError:
    return ScanDamagedError(
        f"The LAS file cannot be read after {num_done:,} of {num_points:,} points ({reason}). {CUT_SHORT}"
    )
