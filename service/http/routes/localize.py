"""`POST /localize`, and the answers and their pictures as long as they live."""

import asyncio
from collections.abc import Coroutine, Sequence
from contextlib import ExitStack
from typing import Any, TypeVar

from fastapi import Depends, Header, Request
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response

from panoloc.core.image.image_header import IMAGE, KNOWN_FORMATS, MASK, open_images
from panoloc.core.image.known_camera import check_known_cameras
from panoloc.core.options import MAX_IMAGES
from panoloc.service.answer import Localization, picture_path
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.access import caller_of, maps_seen, require
from panoloc.service.http.openapi import (
    accepted_response,
    api_router,
    file_response,
    files_part,
    json_part,
    kept_nulls,
    multipart,
    nothing_left,
    path_header,
)
from panoloc.service.http.query_images import query_images, with_pose_of_prior
from panoloc.service.http.schemas.examples import (
    LOCALIZATION_EXAMPLE,
    OPTIONS_EXAMPLE,
    PENDING_EXAMPLE,
    SESSION_EXAMPLE,
)
from panoloc.service.http.schemas.queries import LocalizeOptions, PendingLocalization
from panoloc.service.http.uploads import MAX_PARTS, Form, PartRule, read_form
from panoloc.service.http.validation import limited_by, parse_json
from panoloc.service.jobs import QueryOptions
from panoloc.service.localizations import LocalizeRequest
from panoloc.service.maps.selection import MapChoice
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of
from panoloc.service.settings import Settings

router = api_router("localization")
Result = TypeVar("Result")
QUERY_ERRORS = (400, 401, 403, 404, 408, 409, 413, 415, 422, 429, 503, 504)
"""Statuses of problems that a query may end in."""
OPTION_RULES = {"map_id": PartRule(max_parts=MAX_PARTS), "tag": PartRule(), "options": PartRule()}
"""The parts of a form besides its images, of a query as of a batch."""
MAP_PARTS = {
    "map_id": {"type": "array", "items": {"type": "string"}, "description": "Maps to search; repeat the part."},
    "tag": {
        "type": "string",
        "description": "Instead of `map_id`: all maps with this tag. Neither: all, where the service allows it.",
    },
}
"""The schemas of the parts that name maps."""

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
    **MAP_PARTS,
    "options": json_part(LocalizeOptions),
}
_ERRORS = (401, 403, 404, 503)
_STATE: dict[str, Any] = {
    "description": "The answer; or, while `status` is `queued`, `running` or `failed`, the state of the query.",
    "model": Localization | PendingLocalization,
    "content": {
        "application/json": {
            "examples": kept_nulls({"done": {"value": LOCALIZATION_EXAMPLE}, "running": {"value": PENDING_EXAMPLE}})
        }
    },
}


@router.post(
    "/localize",
    summary="Find where a panorama, a photo or a session was taken",
    dependencies=[Depends(require("localize"))],
    response_model=Localization,
    responses={
        200: {
            "headers": {"Content-Location": path_header("answer")},
            "content": {"application/json": {"example": kept_nulls(LOCALIZATION_EXAMPLE)}},
        },
        **accepted_response(
            PendingLocalization,
            {**PENDING_EXAMPLE, "status": "queued"},
            "With `Prefer: respond-async`: fetch the answer later.",
            "answer",
            *QUERY_ERRORS,
        ),
    },
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
    ),
)
async def localize(
    request: Request,
    response: Response,
    prefer: str | None = Header(None, description="`respond-async`: answer 202 at once."),
) -> Localization | Response:
    """Return the pose of a panorama, a photo or a session. `not_localized` means that no place fits."""
    services = services_of(request)
    max_bytes, setting = services.settings.max_image_bytes, "PANOLOC_MAX_IMAGE_BYTES"
    rules = {
        IMAGE.name: PartRule(max_bytes, setting, max_parts=MAX_IMAGES, max_full_parts=_MAX_FULL_IMAGES),
        MASK.name: PartRule(max_bytes, setting, max_parts=MAX_IMAGES),
        **OPTION_RULES,
    }
    with ExitStack() as stack:
        held = services.bytes_in_flight.hold(caller_of(request).id)
        stack.callback(held.release)
        async with read_form(request.stream(), request.headers, rules, held=held) as form:
            options, maps = parse_json(LocalizeOptions, form.options(), "options"), maps_of(request, form)
            options = await with_pose_of_prior(options, services.localizations, maps_seen(request), maps.map_ids)
            query = query_of(request, form.fields[IMAGE.name], options, maps, form.fields[MASK.name])
        if prefer is not None and "respond-async" in {
            part.partition(";")[0].strip().lower() for part in prefer.split(",")
        }:
            pending = await services.localizations.begin(query, when_done=held.release)
            stack.pop_all()
            headers = {"Location": f"/localizations/{pending['id']}", "Retry-After": str(_RETRY_AFTER_S)}
            return JSONResponse(pending, 202, {**headers, "Preference-Applied": "respond-async"})
        found = await while_connected(request, services.localizations.answer(query))
        response.headers["Content-Location"] = f"/localizations/{found.id}"
        return found


def maps_of(request: Request, form: Form) -> MapChoice:
    """Return the maps that a form names. Raises InvalidOptionsError."""
    tenant, may_be_all = caller_of(request).tenant, services_of(request).settings.search_all
    return MapChoice.from_form(form.texts("map_id"), form.texts("tag"), tenant, may_be_all)


def query_of(
    request: Request, images: Sequence[bytes], options: LocalizeOptions, maps: MapChoice, masks: Sequence[bytes] = ()
) -> LocalizeRequest:
    """Put a query together. Raises InvalidOptionsError, and exceptions of `core` for what is no image, or too large."""
    settings = services_of(request).settings
    if options.hints is not None and options.hints.prior is not None and len(maps.map_ids) != 1:
        raise InvalidOptionsError.of("hints.prior", "expected a query of one map_id, for the pose is in a map; name it")
    if options.hints is not None and options.hints.prior is not None and options.method != "fast":
        raise InvalidOptionsError.of(
            "hints.prior", f"expected the method fast, got {options.method}; leave one of them out"
        )
    query = query_images(images, masks, options)
    with limited_by("PANOLOC_MAX_PIXELS"):
        opened = open_images(images, IMAGE, settings.max_pixels)
        open_images(masks, MASK, settings.max_pixels)
    if options.cameras is None:
        check_known_cameras(opened, images)
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


@router.get(
    "/localizations/{localization_id}",
    summary="Fetch an answer",
    dependencies=[Depends(require("localize"))],
    responses={200: _STATE, **error_responses(*_ERRORS)},
)
async def get_localization(request: Request, localization_id: str) -> Response:
    """Return the answer to a query, or its state."""
    found = await services_of(request).localizations.get(localization_id, caller_of(request).tenant)
    waiting = found["status"] in ("queued", "running")
    return JSONResponse(found, headers={"Retry-After": "1"} if waiting else None)


@router.delete(
    "/localizations/{localization_id}",
    summary="Cancel a query, or delete its answer",
    dependencies=[Depends(require("localize"))],
    status_code=204,
    responses=nothing_left(*_ERRORS),
)
async def delete_localization(request: Request, localization_id: str) -> Response:
    """Cancel a query with `Prefer: respond-async` that has no answer yet; or delete the answer and its pictures."""
    await services_of(request).localizations.forget(localization_id, caller_of(request).tenant)
    return Response(status_code=204)


def _offer_picture(name: str, summary: str, description: str) -> None:
    """Add the path of one picture; `name`: as queries ask for it, see `panoloc.service.jobs.ARTIFACTS`."""

    async def get_picture(request: Request, localization_id: str) -> Response:
        tenant = caller_of(request).tenant
        data = await services_of(request).localizations.picture(localization_id, name, tenant)
        return Response(data, media_type="image/png", headers={"Cache-Control": "private, max-age=3600, immutable"})

    router.add_api_route(
        picture_path("{localization_id}", name),
        get_picture,
        name=f"get_{name}",
        dependencies=[Depends(require("localize"))],
        summary=summary,
        description=description,
        response_class=Response,
        responses=file_response("The picture.", ("image/png",), *_ERRORS),
    )


_offer_picture(
    "score_map_2d", "The panorama tinted by its score map", "Return a picture of how well the panorama fits the scan."
)
_offer_picture(
    "score_map_3d",
    "The scan at the estimated pose, tinted by its score map",
    "Return a picture of how well the scan fits the panorama.",
)
_offer_picture(
    "overlay",
    "The panorama above the scan at the estimated pose",
    "Return a picture for checking the pose by eye.",
)
