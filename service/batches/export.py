"""Exports and plans of a batch, each written by a process of its own, because that needs numpy and the photos."""

import asyncio
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

from panoloc.core.errors import ExportRefusedError
from panoloc.core.options import ExportFormat
from panoloc.core.scan.format_detection import detect_format
from panoloc.service.batches.record import BatchRecord, image_key
from panoloc.service.batches.tour import Photo, lacks_place, maps_of, overview_document, tour_document, why_left_out
from panoloc.service.errors import StoredFileMissingError
from panoloc.service.host.written_files import written_file
from panoloc.service.jobs import Result
from panoloc.service.maps.reading import is_in_map_frame
from panoloc.service.maps.record import MapRecord, key_of, map_document
from panoloc.service.storage import Storage

_WITHOUT_MAP = (
    "Without points, walls, floors and scans of the map, and without its place on Earth: the map was deleted, or is "
    "not yours to see."
)


@dataclass(frozen=True)
class ExportRequest:
    """One export. results: of the images that have one, by number. map_id: whose photos."""

    record: BatchRecord
    results: Mapping[int, Result]
    format: ExportFormat
    map_id: str
    include_ambiguous: bool


def map_of(record: BatchRecord, results: Mapping[int, Result], wanted: str | None) -> str:
    """Return the map whose photos are exported: the wanted or the only one. Raises ExportRefusedError for several."""
    found = maps_of(results.values())
    if wanted is not None:
        return wanted
    if len(found) > 1:
        raise ExportRefusedError(
            f"expected photos of one map, got photos of {', '.join(found)}, which have different axes; choose one "
            "with map_id"
        )
    return found[0] if found else next(iter(record.map_ids), "none")


async def open_export(storage: Storage, wanted: ExportRequest, place: MapRecord | None, time_s: float) -> BinaryIO:
    """Return the open zip, which has no name any more, so that nothing is left of it when it is closed.

    place: the map; None: it was deleted, so that its points and georeference are missing. Raises ExportRefusedError,
    StorageError and ExportFailedError.
    """
    with ExitStack() as stack:
        document = await asyncio.to_thread(_tour_document, storage, wanted, place, stack)
        try:
            return await written_file(
                storage, "panoloc.core.exports", document, wanted.format, suffix=".zip", time_s=time_s
            )
        except ExportRefusedError as error:
            if place is None or not lacks_place(wanted.format, document):
                raise
            raise ExportRefusedError(f"{error}; PATCH /maps/{place.id} sets one") from error


async def draw_plan(
    storage: Storage,
    record: BatchRecord,
    results: Mapping[int, Result],
    map_id: str,
    place: MapRecord | None,
    time_s: float,
) -> bytes:
    """Return a PNG: the scan from above with the photos placed in a map. place: the map; None: it was deleted.

    Raises StorageError and ExportFailedError.
    """
    with ExitStack() as stack:
        photos = [Photo(name, None, results.get(number)) for number, name in enumerate(record.names)]
        document = overview_document(map_id, await asyncio.to_thread(_points, storage, place, stack), photos)
        with await written_file(
            storage, "panoloc.core.exports.overview", document, suffix=".png", time_s=time_s
        ) as picture:
            return await asyncio.to_thread(picture.read)


def _tour_document(
    storage: Storage, wanted: ExportRequest, place: MapRecord | None, stack: ExitStack
) -> dict[str, Any]:
    """Return the tour; stack: keeps the files of photos and points where they are."""
    photos = []
    for number, name in enumerate(wanted.record.names):
        result, image = wanted.results.get(number), None
        if why_left_out(result, wanted.map_id, wanted.include_ambiguous) is None:
            image = stack.enter_context(storage.local_copy(image_key(wanted.record.id, number), checked=False))
        photos.append(Photo(name, image, result))
    points = _points(storage, place, stack)
    tour = tour_document(
        wanted.map_id,
        wanted.include_ambiguous,
        photos,
        datetime.fromisoformat(wanted.record.created_at).timestamp(),
        {} if place is None else map_document(place, None),
        points,
        _survey(storage, place, stack) if wanted.format == "e57" else None,
    )
    return {**tour, "lacks": _WITHOUT_MAP if points is None else None}


def _points(storage: Storage, place: MapRecord | None, stack: ExitStack) -> Path | None:
    ref = None if place is None else place.serving_ref
    return None if ref is None else _copy(storage, key_of(ref, "points.ply"), stack)


def _survey(storage: Storage, place: MapRecord | None, stack: ExitStack) -> Path | None:
    """Return the scan itself where it is an E57 in the frame of the map, whatever its name says."""
    serving = None if place is None else place.serving
    if serving is None or not is_in_map_frame(serving):
        return None
    scan = _copy(storage, serving.scan_key, stack, checked=False)
    return scan if scan is not None and detect_format(scan, None)[0] == "e57" else None


def _copy(storage: Storage, key: str, stack: ExitStack, checked: bool = True) -> Path | None:
    """Return a file of a map, None if a newer scan has just taken its place."""
    try:
        return stack.enter_context(storage.local_copy(key, checked=checked))
    except StoredFileMissingError:
        return None
