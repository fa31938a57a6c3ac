"""Upload many images to be localized one by one, and list and rename what was uploaded."""

import asyncio
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated

from fastapi import Depends, Query, Request
from starlette.responses import JSONResponse, Response

from panoloc.core.image.image_header import KNOWN_FORMATS
from panoloc.service.batches.archive import UnpackedImage, unique_names, unpack_images
from panoloc.service.batches.record import BatchRecord
from panoloc.service.errors import ArchiveError, InvalidOptionsError
from panoloc.service.http.access import caller_of, hold_upload_place, note_change, own_batch, require
from panoloc.service.http.openapi import (
    accepted_response,
    api_router,
    binary_part,
    files_part,
    json_body,
    json_part,
    json_response,
    multipart,
)
from panoloc.service.http.routes.batches import batch_document, batch_overview
from panoloc.service.http.routes.localize import MAP_PARTS, OPTION_RULES, checked_options, maps_of
from panoloc.service.http.schemas.batches import Batch, BatchOptions, BatchOverview, BatchPage, BatchPatch
from panoloc.service.http.schemas.examples import BATCH_OVERVIEW_EXAMPLE, BATCH_PAGE_EXAMPLE, QUEUED_BATCH_EXAMPLE
from panoloc.service.http.schemas.maps import name_of_file
from panoloc.service.http.uploads import MAX_PARTS, Form, PartRule, read_body, read_form
from panoloc.service.http.validation import parse_json
from panoloc.service.jobs import new_id, now
from panoloc.service.maps.known_maps import decode_cursor, encode_cursor
from panoloc.service.services import Services, services_of
from panoloc.service.settings import Settings
from panoloc.service.storage.disk import disk_errors

router = api_router("batches")

_RETRY_AFTER_S = 1
# So many images of a batch may be as large as one may be; photos are mostly a tenth of that.
_MAX_FULL_IMAGES = 256
_ZIP_HEADS = (b"PK\x03\x04", b"PK\x05\x06")
_ACCEPTED = "The images are stored; poll the batch until it is done."


@router.get(
    "/batches",
    summary="List batches",
    dependencies=[Depends(require("read"))],
    responses=json_response(BatchPage, BATCH_PAGE_EXAMPLE, 401, 403, 422),
)
async def list_batches(
    request: Request,
    limit: Annotated[int, Query(ge=1, le=200, description="Batches on a page.")] = 50,
    cursor: Annotated[str | None, Query(description="`next_cursor` of the previous page.", max_length=512)] = None,
) -> Response:
    """Return the caller's batches, oldest first, page by page.

    `GET /batches/{id}` has the images and counts of a batch.
    """
    batches = services_of(request).batches
    place = ("", "") if cursor is None else decode_cursor(cursor)
    found = batches.after(place, caller_of(request).tenant)
    page = found[:limit]
    more = len(found) > limit
    body = {
        "items": [batch_overview(record, batches.num_done(record.id)) for record in page],
        "next_cursor": encode_cursor(page[-1].created_at, page[-1].id) if more else None,
    }
    return JSONResponse(body)


@router.patch(
    "/batches/{batch_id}",
    summary="Rename a batch",
    dependencies=[Depends(require("localize"))],
    responses=json_response(BatchOverview, BATCH_OVERVIEW_EXAMPLE, 400, 401, 403, 404, 408, 413, 422, 503),
    openapi_extra=json_body(BatchPatch, {"name": "3rd floor, 21 November"}),
)
async def rename_batch(request: Request, batch_id: str) -> Response:
    """Change the name, and return the batch as lists have it."""
    batches = services_of(request).batches
    own_batch(request, batch_id)
    patch = parse_json(BatchPatch, await read_body(request.stream()), "body")
    record = await batches.rename(batch_id, patch.name)
    note_change(request, "batch renamed", batch_id)
    return JSONResponse(batch_overview(record, batches.num_done(batch_id)))


@router.post(
    "/batches",
    summary="Localize many images, one by one",
    dependencies=[Depends(require("localize")), Depends(hold_upload_place)],
    status_code=202,
    responses=accepted_response(
        Batch, QUEUED_BATCH_EXAMPLE, _ACCEPTED, "batch", 400, 401, 403, 404, 409, 413, 415, 422, 503
    ),
    openapi_extra=multipart(
        {
            "image": files_part(f"A panorama or a photo; {KNOWN_FORMATS}. Repeat the part.", 2000),
            "archive": binary_part("Instead of `image`: a zip of images, optionally in folders."),
            **MAP_PARTS,
            "options": json_part(BatchOptions),
        },
        [],
        {"two photos": {"value": {"image": ["(the bytes)", "(the bytes)"], "map_id": ["map_2xk7q0v9m3d1c8fa"]}}},
        oneOf=[{"required": ["image"]}, {"required": ["archive"]}],
    ),
)
async def post_batch(request: Request) -> Response:
    """Store the images durably, then localize them in the background, without delaying other queries."""
    services = services_of(request)
    settings = services.settings
    services.batches.check_room()
    folder, most_parts = await asyncio.to_thread(services.storage.spool_folder), settings.max_batch_images + MAX_PARTS
    async with read_form(request.stream(), request.headers, _rules(settings), folder, max_parts=most_parts) as form:
        options = parse_json(BatchOptions, form.options(), "options")
        if options.timeout_s is None:
            # Nobody waits for an image of a batch, and a busy service must not fail it for good.
            options = options.model_copy(update={"timeout_s": settings.max_timeout_s})
        maps = maps_of(request, form)
        await services.registry.find(maps.map_ids)
        maps.resolve(services.registry)
        images, ignored = await _images(form, services, folder)
        try:
            record = BatchRecord(
                id=new_id("batch"),
                created_at=now(),
                map_ids=maps.map_ids,
                tag=maps.tag,
                options=checked_options(options, settings),
                camera=options.cameras[0].to_options() if options.cameras else None,
                names=tuple(unique_names(image.name for image in images)),
                ignored=tuple(ignored),
                tenant=maps.tenant,
                name=options.name or _name_of(form, images),
                answers=_answers(options, images, bool(form.files["archive"])),
            )
            await services.batches.add(record, [(image.path, image.sha256) for image in images])
        finally:
            for image in images:
                image.path.unlink(missing_ok=True)
    services.batch_runs.begin(record)
    note_change(request, "batch made", record.id)
    headers = {"Location": f"/batches/{record.id}", "Retry-After": str(_RETRY_AFTER_S)}
    return JSONResponse(await batch_document(services, record, []), 202, headers)


def _rules(settings: Settings) -> dict[str, PartRule]:
    max_bytes, setting = settings.max_image_bytes, "PANOLOC_MAX_IMAGE_BYTES"
    return {
        "image": PartRule(
            max_bytes,
            setting,
            spooled=True,
            max_parts=settings.max_batch_images,
            max_full_parts=_MAX_FULL_IMAGES,
        ),
        "archive": PartRule(
            max_bytes * _MAX_FULL_IMAGES, f"{_MAX_FULL_IMAGES} times {setting}", spooled=True, check_head=_check_zip
        ),
        **OPTION_RULES,
    }


def _check_zip(head: bytes, name: str) -> None:
    if not head.startswith(_ZIP_HEADS):
        raise ArchiveError(
            f"archive: expected a zip, got {name[:80]!r}, which is not a zip; send images in parts named `image`"
        )


def _name_of(form: Form, images: Sequence[UnpackedImage]) -> str:
    """Return the name of the archive or of the folder that all images are in, else the time."""
    folders = {PurePosixPath(image.name).parts[0] for image in images if "/" in image.name}
    archives = [PurePosixPath(file.name).stem for file in form.files["archive"]]
    folder = folders.pop() if len(folders) == 1 and all("/" in image.name for image in images) else ""
    return name_of_file(archives[0] if archives else folder) or f"Photos of {now()[:16].replace('T', ' ')}"


def _answers(options: BatchOptions, images: Sequence[UnpackedImage], is_archive: bool) -> tuple[str | None, ...]:
    """Return the ids of answers of the images. Raises InvalidOptionsError."""
    if options.answers is not None and (is_archive or len(options.answers) != len(images)):
        got = "an archive" if is_archive else f"{len(options.answers)} of them"
        raise InvalidOptionsError.of("answers", f"expected one for each of the {len(images)} parts `image`, got {got}")
    return tuple(options.answers or ())


async def _images(form: Form, services: Services, folder: Path) -> tuple[list[UnpackedImage], list[str]]:
    """Return the images that were sent, one way or the other. Raises InvalidOptionsError, ArchiveError and
    UploadTooLargeError."""
    archives = form.files["archive"]
    images = [UnpackedImage(file.name, file.path, file.sha256) for file in form.files["image"]]
    if bool(images) == bool(archives):
        got = "both" if images else "neither"
        message = f"expected either images in parts of this name or a zip as archive, got {got}"
        raise InvalidOptionsError.of("image", f"{message}; send -F image=@photo.jpg")
    if not archives:
        return images, []
    settings = services.settings
    most_bytes = settings.max_image_bytes
    limits = settings.max_batch_images, most_bytes, most_bytes * _MAX_FULL_IMAGES
    with disk_errors():
        images, ignored = await asyncio.to_thread(unpack_images, archives[0].path, folder, *limits)
    if not images:
        raise ArchiveError(
            "archive: expected images, got a zip without any; image names end in .jpg, .png, .webp, .heic or .avif"
        )
    return images, ignored
