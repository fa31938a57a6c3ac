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
class PlacedBatch:
    """What is exported. results: of the images that have one, by number. map_id: whose photos.

    place: the map; None where it was deleted or the caller does not see it, so that its points and its place on Earth are missing.
    """

    record: BatchRecord
    results: Mapping[int, Result]
    map_id: str
    place: MapRecord | None


def map_of(record: BatchRecord, results: Mapping[int, Result], wanted: str | None) -> str:
    """Return the map whose photos are exported: the wanted or the only one.

    Raises ExportRefusedError for several, and for a wanted one that is none of the batch.
    """
    found = maps_of(results.values())
    if wanted is not None:
        known = sorted({*record.map_ids, *found})
        if wanted not in known:
            raise ExportRefusedError(
                f"map_id: expected a map of the batch, {' or '.join(known) or 'and it has none yet'}, got {wanted!r}; choose "
                "another, or none"
            )
        return wanted
    if len(found) > 1:
        raise ExportRefusedError(
            f"expected photos of one map, got photos of {', '.join(found)}, which have different axes; choose one "
            "with map_id"
        )
    return found[0] if found else next(iter(record.map_ids), "none")


async def open_export(storage: Storage, batch: PlacedBatch, format: ExportFormat, include_ambiguous: bool) -> BinaryIO:
    """Return the open zip, which has no name any more, so that nothing is left of it when it is closed.

    Raises ExportRefusedError, StorageError and ExportFailedError.
    """
    with ExitStack() as stack:
        document = await asyncio.to_thread(_tour_document, storage, batch, format, include_ambiguous, stack)
        try:
            return await written_file(storage, "panoloc.core.exports", document, format, suffix=".zip")
        except ExportRefusedError as error:
            if batch.place is None or not lacks_place(format, document):
                raise
            raise ExportRefusedError(f"{error}; PATCH /maps/{batch.place.id} sets one") from error


async def draw_plan(storage: Storage, batch: PlacedBatch) -> bytes:
    """Return a PNG: the scan from above with the photos placed in the map. Raises StorageError and ExportFailedError."""
    with ExitStack() as stack:
        photos = [Photo(name, None, batch.results.get(number)) for number, name in enumerate(batch.record.names)]
        points = await asyncio.to_thread(_points, storage, batch.place, stack)
        document = overview_document(batch.map_id, points, photos)
        with await written_file(storage, "panoloc.core.exports.overview", document, suffix=".png") as picture:
            return await asyncio.to_thread(picture.read)


def _tour_document(
    storage: Storage, batch: PlacedBatch, format: ExportFormat, include_ambiguous: bool, stack: ExitStack
) -> dict[str, Any]:
    """Return the tour; stack: keeps the files of photos and points where they are."""
    photos = []
    for number, name in enumerate(batch.record.names):
        result, image = batch.results.get(number), None
        if why_left_out(result, batch.map_id, include_ambiguous) is None:
            image = stack.enter_context(storage.local_copy(image_key(batch.record.id, number), checked=False))
        photos.append(Photo(name, image, result))
    points = _points(storage, batch.place, stack)
    tour = tour_document(
        batch.map_id,
        include_ambiguous,
        photos,
        datetime.fromisoformat(batch.record.created_at).timestamp(),
        {} if batch.place is None else map_document(batch.place, None),
        points,
        _survey(storage, batch.place, stack) if format == "e57" else None,
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
