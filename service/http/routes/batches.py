"""Watch a batch, fetch what came of it, delete it."""

import asyncio
import os
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from typing import Annotated, Any, BinaryIO, Literal, TypeVar

from fastapi import Depends, Path, Query, Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from panoloc.core.image.conversion import converted
from panoloc.core.image.image_header import CONVERTED_KINDS, IMAGE, image_kind
from panoloc.core.options import ExportFormat
from panoloc.service.batches.export import PlacedBatch, draw_plan, map_of, open_export
from panoloc.service.batches.record import BatchRecord
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.access import maps_seen, note_change, own_batch, require, while_there
from panoloc.service.http.openapi import api_router, file_response, json_response, nothing_left
from panoloc.service.http.routes.localize import while_connected
from panoloc.service.http.schemas.batches import Batch
from panoloc.service.http.schemas.examples import BATCH_EXAMPLE
from panoloc.service.jobs import Result
from panoloc.service.services import Services, services_of

Made = TypeVar("Made")
router = api_router("batches", Depends(require("localize")))

_MapId = Annotated[str | None, Query(description="Only photos placed in this map.", max_length=80)]
_MAX_IGNORED = 100
_BLOCK_BYTES = 2**20
_STATUSES = ("localized", "ambiguous", "not_localized", "failed")
_IMAGE_TYPES = ("image/jpeg", "image/png", "image/webp")
_ZIP = "A zip with the files of the format, `unplaced.txt` and `export.json`."


@router.get(
    "/batches/{batch_id}",
    summary="Show a batch and the results of its images",
    responses=json_response(Batch, BATCH_EXAMPLE, 401, 403, 404, 422),
)
async def get_batch(
    request: Request,
    batch_id: str,
    limit: Annotated[int, Query(ge=0, le=200, description="Images on a page; 0 for the counts alone.")] = 50,
    cursor: Annotated[str | None, Query(description="`next_cursor` of the previous page.", max_length=20)] = None,
) -> Response:
    """Return counts and progress, and the images page by page."""
    services = services_of(request)
    record = own_batch(request, batch_id)
    first = _first_of(cursor)
    numbers = range(first, min(first + limit, len(record.names)))
    document = await batch_document(services, record, numbers)
    waiting = document["status"] != "done"
    return JSONResponse(document, headers={"Retry-After": "1"} if waiting else None)


@router.get(
    "/batches/{batch_id}/images/{number}",
    summary="Fetch an image of a batch",
    response_class=Response,
    responses=file_response("The bytes as uploaded; of a HEIC or AVIF a JPEG.", _IMAGE_TYPES, 401, 403, 404, 413, 422),
)
async def get_image(
    request: Request,
    batch_id: str,
    number: Annotated[int, Path(ge=0, description="`number` of its item.")],
    max_side: Annotated[
        int | None, Query(ge=32, le=4096, description="Instead: an upright JPEG, no side longer than so many pixels.")
    ] = None,
) -> Response:
    """Return an image as uploaded; a HEIC or AVIF as a JPEG, which all programs show. A file of another kind is returned as plain bytes."""
    services = services_of(request)
    own_batch(request, batch_id, number)
    data = await services.batches.image(batch_id, number)
    if max_side is not None or image_kind(data) in CONVERTED_KINDS:
        async with services.export_turns:
            data = await asyncio.to_thread(converted, data, IMAGE, services.settings.max_pixels, max_side)
    kind = image_kind(data)
    media_type = f"image/{kind}" if kind else "application/octet-stream"
    headers = {"Cache-Control": "private, max-age=3600, immutable", "X-Content-Type-Options": "nosniff"}
    return Response(data, media_type=media_type, headers=headers)


@router.get(
    "/batches/{batch_id}/export",
    summary="Fetch the placed photos in the format of another system",
    response_class=Response,
    responses=file_response(_ZIP, ("application/zip",), 401, 403, 404, 422),
)
async def get_export(
    request: Request,
    batch_id: str,
    format: Annotated[ExportFormat, Query(description="See docs/exports.md.")],
    include: Annotated[
        Literal["ambiguous"] | None, Query(description="Also export ambiguous photos, at the most likely place.")
    ] = None,
    map_id: _MapId = None,
) -> Response:
    """Return the photos placed so far. Photos without a pose are listed separately, never written with zeros."""
    storage, ambiguous = services_of(request).storage, include == "ambiguous"
    made = _made(request, batch_id, map_id, lambda batch: open_export(storage, batch, format, ambiguous))
    file = await while_connected(request, made)
    name = re.sub(r"[^\w.-]+", "_", own_batch(request, batch_id).name[:80], flags=re.ASCII).strip("_.-") or batch_id
    headers = {
        "Content-Disposition": f'attachment; filename="{name}-{format}.zip"',
        "Content-Length": str(os.fstat(file.fileno()).st_size),
    }
    return StreamingResponse(_blocks(file), media_type="application/zip", headers=headers)


@router.get(
    "/batches/{batch_id}/plan.png",
    summary="The scan from above, with the photos placed so far",
    response_class=Response,
    responses=file_response("The picture.", ("image/png",), 401, 403, 404, 422),
)
async def get_plan(request: Request, batch_id: str, map_id: _MapId = None) -> Response:
    """Return a plan with the position and direction of each photo, numbered from 1 in the order of the upload.

    Hollow dots are further places of ambiguous photos.
    """
    storage = services_of(request).storage
    made = _made(request, batch_id, map_id, lambda batch: draw_plan(storage, batch))
    picture = await while_connected(request, made)
    return Response(picture, media_type="image/png", headers={"Cache-Control": "private, no-cache"})


@router.delete(
    "/batches/{batch_id}",
    summary="Delete a batch with its images; a running batch is cancelled",
    status_code=204,
    responses=nothing_left(401, 403, 404),
)
async def delete_batch(request: Request, batch_id: str) -> Response:
    """Cancel running work, and delete images and results. This cannot be undone."""
    services = services_of(request)
    own_batch(request, batch_id)
    await services.batch_runs.cancel(batch_id)
    await services.batches.remove(batch_id)
    await asyncio.to_thread(services.changes.forget_batch, batch_id)
    services.changed_objects.forget()
    note_change(request, "batch deleted", batch_id)
    return Response(status_code=204)


def batch_overview(record: BatchRecord, num_done: int) -> dict[str, Any]:
    """Return a batch as lists have it; num_done: images with a result."""
    num_images = len(record.names)
    return {
        "id": record.id,
        "name": record.name or f"{num_images} {'photo' if num_images == 1 else 'photos'}",
        "status": "done" if num_done == num_images else "running" if num_done else "queued",
        "created_at": record.created_at,
        "map_ids": list(record.map_ids),
        "tag": record.tag,
        "num_images": num_images,
        "progress": round(num_done / num_images, 4),
    }


async def batch_document(services: Services, record: BatchRecord, numbers: Iterable[int]) -> dict[str, Any]:
    """Return a batch as JSON with a page of its images; numbers: theirs, in order."""
    page = list(numbers)
    counts = await services.batches.counts(record.id)
    results = await services.batches.results(record.id, page)
    num_images, num_done = len(record.names), counts.total()
    more = bool(page) and page[-1] + 1 < num_images
    return {
        **batch_overview(record, num_done),
        "counts": {"waiting": num_images - num_done, **{status: counts[status] for status in _STATUSES}},
        "ignored": list(record.ignored[:_MAX_IGNORED]),
        "items": [item_document(record, number, results.get(number)) for number in page],
        "next_cursor": str(page[-1] + 1) if more else None,
    }


async def _made(
    request: Request, batch_id: str, map_id: str | None, make: Callable[[PlacedBatch], Awaitable[Made]]
) -> Made:
    """Return what `make` makes, in its turn, of the photos of a batch in a map."""
    services, record = services_of(request), own_batch(request, batch_id)
    async with services.export_turns:
        results = await services.batches.results(batch_id, range(len(record.names)))
        of = map_of(record, results, map_id)
        await services.registry.find([of])
        maps = maps_seen(request)
        if not maps.has(of):
            return await make(PlacedBatch(record, results, of, None))
        async with while_there(request, of):
            return await make(PlacedBatch(record, results, of, maps.get(of)))


def item_document(record: BatchRecord, number: int, result: Result | None) -> dict[str, Any]:
    """Return an image as a page has it. result: None while there is none."""
    found = result or {"status": "waiting"}
    return {
        "number": number,
        "name": record.names[number],
        "status": found["status"],
        "answer": found.get("answer"),
        "error": found.get("error"),
    }


def _first_of(cursor: str | None) -> int:
    if cursor is None:
        return 0
    if cursor.isascii() and cursor.isdigit():
        return int(cursor)
    message = f"expected the next_cursor of an earlier page, got {cursor!r}; begin again without a cursor"
    raise InvalidOptionsError.of("cursor", message)


async def _blocks(file: BinaryIO) -> AsyncIterator[bytes]:
    with file:
        while block := await asyncio.to_thread(file.read, _BLOCK_BYTES):
            yield block
