"""`POST /localize`."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from fastapi import APIRouter, Depends, Header, Request
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response

from panoloc.core.options import MAX_IMAGES
from panoloc.core.panorama.image_header import IMAGE, KNOWN_FORMATS, MASK, check_images
from panoloc.core.panorama.known_camera import check_known_cameras
from panoloc.service.answer import Localization
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.access import caller_of, require
from panoloc.service.http.openapi import accepted_headers, files_part, json_part, multipart
from panoloc.service.http.query_images import query_images
from panoloc.service.http.schemas import LocalizeOptions, PendingLocalization
from panoloc.service.http.schemas.localization_examples import (
    LOCALIZATION_EXAMPLE,
    OPTIONS_EXAMPLE,
    PENDING_EXAMPLE,
    SESSION_EXAMPLE,
)
from panoloc.service.http.spool import PartRule
from panoloc.service.http.uploads import MAX_PARTS, read_form
from panoloc.service.http.validation import limited_by, parse_json
from panoloc.service.jobs import QueryOptions
from panoloc.service.limits.capacity import Held
from panoloc.service.localizations import LocalizeRequest
from panoloc.service.maps.selection import MapChoice
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of
from panoloc.service.settings import Settings

router = APIRouter(tags=["localization"])
Result = TypeVar("Result")

_RETRY_AFTER_S = 1
# Images of a query that may have the full size: 32 frames of a phone together are smaller.
_MAX_FULL_IMAGES = 4
_PARTS = {
    "image": files_part(
        f"A 2:1 equirectangular panorama, or a part of one with GPano fields, or a photo; {KNOWN_FORMATS}. Repeat the part for the images "
        "of a session, each with its entry in `options.cameras`.",
        MAX_IMAGES,
    ),
    "mask": files_part(
        "A mask image of the same shape: its non-zero pixels are ignored in the query. One for all images, or one "
        "per image in their order.",
        MAX_IMAGES,
    ),
    "map_id": {"type": "array", "items": {"type": "string"}, "description": "Maps to search; repeat the part."},
    "tag": {"type": "string", "description": "Instead of `map_id`: all maps with this tag."},
    "options": json_part(LocalizeOptions),
}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/json": {"example": LOCALIZATION_EXAMPLE}}},
    202: {
        "model": PendingLocalization,
        "description": "With `Prefer: respond-async`: fetch the answer later.",
        "headers": accepted_headers("answer"),
        "content": {"application/json": {"example": {**PENDING_EXAMPLE, "status": "queued"}}},
    },
}


@router.post(
    "/localize",
    summary="Find where a panorama, a photo or a session was taken",
    dependencies=[Depends(require("localize"))],
    response_model=Localization,
    responses={**_RESPONSES, **error_responses(400, 401, 403, 404, 408, 409, 413, 415, 422, 429, 503, 504)},
    openapi_extra=multipart(
        _PARTS,
        ["image"],
        {
            "in one map": {
                "value": {"image": ["(the bytes)"], "map_id": ["map_2xk7q0v9m3d1c8fa"], "options": OPTIONS_EXAMPLE}
            },
            "two frames of a session": {
                "value": {
                    "image": ["(the bytes)", "(the bytes)"],
                    "map_id": ["map_2xk7q0v9m3d1c8fa"],
                    "options": SESSION_EXAMPLE,
                }
            },
        },
        oneOf=[{"required": ["map_id"]}, {"required": ["tag"]}],
    ),
)
async def localize(
    request: Request,
    prefer: str | None = Header(None, description="`respond-async`: answer 202 at once."),
) -> Localization | Response:
    """Return the pose of a panorama, a photo or a session. `not_localized` means that no place fits."""
    services = services_of(request)
    held = services.bytes_in_flight.hold(caller_of(request).id)
    try:
        return await _answer(request, prefer, held)
    except BaseException:
        held.release()
        raise


async def _answer(request: Request, prefer: str | None, held: Held) -> Localization | Response:
    services = services_of(request)
    query = await _query(request, services.settings, held)
    if prefer is not None and "respond-async" in {part.strip().lower() for part in prefer.split(",")}:
        pending = await services.localizations.begin(query, when_done=held.release)
        headers = {"Location": f"/localizations/{pending['id']}", "Retry-After": str(_RETRY_AFTER_S)}
        return JSONResponse(pending, 202, {**headers, "Preference-Applied": "respond-async"})
    answer = await while_connected(request, services.localizations.answer(query))
    held.release()
    return answer


async def _query(request: Request, settings: Settings, held: Held) -> LocalizeRequest:
    max_bytes, setting = settings.max_image_bytes, "PANOLOC_MAX_IMAGE_BYTES"
    rules = {
        "image": PartRule(max_bytes, setting, max_parts=MAX_IMAGES, max_full_parts=_MAX_FULL_IMAGES),
        "mask": PartRule(max_bytes, setting, max_parts=MAX_IMAGES),
        "map_id": PartRule(max_parts=MAX_PARTS),
        "tag": PartRule(),
        "options": PartRule(),
    }
    with await read_form(request.stream(), request.headers, rules, held=held) as form:
        options = parse_json(LocalizeOptions, form.single("options"), "options")
        maps = MapChoice.from_form(form.texts("map_id"), form.texts("tag"), caller_of(request).tenant)
        images, masks = form.all(IMAGE.name), form.all(MASK.name)
    query = query_images(images, masks, options)
    with limited_by("PANOLOC_MAX_PIXELS"):
        check_images(images, IMAGE, settings.max_pixels)
        check_images(masks, MASK, settings.max_pixels)
    if options.cameras is None:
        check_known_cameras(images)
    return LocalizeRequest(query, maps, checked_options(options, settings), request.state.request_id)


def checked_options(given: LocalizeOptions, settings: Settings) -> QueryOptions:
    """Return the options for the worker. Raises InvalidOptionsError for a longer timeout than the operator allows."""
    is_searching_field_of_view = any(camera.hfov_range_deg for camera in given.cameras or ())
    options = given.to_options(settings.timeout_s_of(given.method, is_searching_field_of_view))
    if options.timeout_s > settings.max_timeout_s:
        raise InvalidOptionsError.of(
            "timeout_s",
            f"expected at most {settings.max_timeout_s:g} seconds, got {options.timeout_s:g}; request less, or "
            "ask the operator to raise PANOLOC_MAX_TIMEOUT_S",
        )
    return options


async def while_connected(request: Request, work: Coroutine[Any, Any, Result]) -> Result:
    """Return the result of `work`, or cancel it when the caller disconnects. Raises ClientDisconnect."""
    task = asyncio.create_task(work)
    watch = asyncio.create_task(_disconnected(request))
    try:
        await asyncio.wait({task, watch}, return_when=asyncio.FIRST_COMPLETED)
        if not task.done():
            raise ClientDisconnect
        return task.result()
    finally:
        task.cancel()
        watch.cancel()


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
