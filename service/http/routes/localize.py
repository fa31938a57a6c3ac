"""Ask where a panorama was taken."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from fastapi import APIRouter, Depends, Header, Request
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response

from core.panorama.image_header import IMAGE, KNOWN_FORMATS, MASK, Upload, check_image
from service.answer import Document
from service.errors import InvalidOptionsError
from service.http.access import require
from service.http.openapi import accepted_headers, binary_part, json_part, multipart
from service.http.schemas import Localization, LocalizeOptions, PendingLocalization
from service.http.schemas.localization import LOCALIZATION_EXAMPLE, OPTIONS_EXAMPLE, PENDING_EXAMPLE
from service.http.spool import PartRule
from service.http.uploads import Form, read_form
from service.http.validation import limited_by, parse_json
from service.jobs import QueryOptions
from service.localizations import LocalizeRequest
from service.maps.selection import MapChoice
from service.problems import error_responses
from service.services import services_of
from service.settings import Settings

router = APIRouter(tags=["localization"])

_RETRY_AFTER_S = 1
_PARTS = {
    "image": binary_part(f"The panorama: 2:1 equirectangular, or cropped with GPano fields; {KNOWN_FORMATS}."),
    "mask": binary_part("An image of the same shape; pixels that are not zero are ignored."),
    "map_id": {"type": "array", "items": {"type": "string"}, "description": "Maps to search; repeat the part."},
    "tag": {"type": "string", "description": "Instead of `map_id`: all maps that bear this tag."},
    "options": json_part(LocalizeOptions),
}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": Localization, "content": {"application/json": {"example": LOCALIZATION_EXAMPLE}}},
    202: {
        "model": PendingLocalization,
        "description": "With `Prefer: respond-async`: the answer is fetched later.",
        "headers": accepted_headers("answer"),
        "content": {"application/json": {"example": {**PENDING_EXAMPLE, "status": "queued"}}},
    },
}


@router.post(
    "/localize",
    summary="Find where a panorama was taken",
    dependencies=[Depends(require("read"))],
    response_model=None,
    responses={**_RESPONSES, **error_responses(400, 401, 403, 404, 409, 413, 415, 422, 429, 503, 504)},
    openapi_extra=multipart(
        _PARTS,
        ["image"],
        {
            "in one map": {
                "value": {"image": "(the bytes)", "map_id": ["map_2xk7q0v9m3d1c8fa"], "options": OPTIONS_EXAMPLE}
            }
        },
        oneOf=[{"required": ["map_id"]}, {"required": ["tag"]}],
    ),
)
async def localize(
    request: Request,
    prefer: str | None = Header(None, description="`respond-async`: answer 202 at once."),
) -> Response:
    """Return the pose of a panorama, or say that it fits nowhere (`not_localized`), which is an answer too."""
    services = services_of(request)
    query = await _query(request, services.settings)
    if prefer is not None and "respond-async" in {part.strip().lower() for part in prefer.split(",")}:
        pending = await services.localizations.begin(query)
        headers = {"Location": f"/localizations/{pending['id']}", "Retry-After": str(_RETRY_AFTER_S)}
        return JSONResponse(pending, 202, {**headers, "Preference-Applied": "respond-async"})
    return JSONResponse(await _while_connected(request, services.localizations.answer(query)))


async def _query(request: Request, settings: Settings) -> LocalizeRequest:
    image_rule = PartRule(settings.max_image_bytes, "PANOLOC_MAX_IMAGE_BYTES")
    rules = {
        "image": image_rule,
        "mask": image_rule,
        "map_id": PartRule(repeatable=True),
        "tag": PartRule(),
        "options": PartRule(),
    }
    with await read_form(request.stream(), request.headers, rules) as form:
        options = parse_json(LocalizeOptions, form.single("options"), "options")
        maps = MapChoice.from_form(form.texts("map_id"), form.texts("tag"))
        panorama = _image(form, IMAGE, settings)
        if panorama is None:
            raise _image_missing()
        mask = _image(form, MASK, settings)
    return LocalizeRequest(panorama, mask, maps, _checked(options, settings), request.state.request_id)


def _image(form: Form, upload: Upload, settings: Settings) -> bytes | None:
    data = form.single(upload.name)
    if data is not None:
        with limited_by("PANOLOC_MAX_PIXELS"):
            check_image(data, upload, settings.max_pixels)
    return data


def _checked(given: LocalizeOptions, settings: Settings) -> QueryOptions:
    options = given.to_options(settings.timeout_s_of(given.method))
    if options.timeout_s > settings.max_timeout_s:
        message = (
            f"expected at most {settings.max_timeout_s:g} seconds, got {options.timeout_s:g}; ask for less, or let the operator "
            "raise PANOLOC_MAX_TIMEOUT_S where the service runs"
        )
        raise InvalidOptionsError(f"timeout_s: {message}", [{"field": "timeout_s", "message": message}])
    return options


def _image_missing() -> InvalidOptionsError:
    message = "expected the panorama in a part of this name, got none; send -F image=@photo.jpg"
    return InvalidOptionsError(f"image: {message}", [{"field": "image", "message": message}])


async def _while_connected(request: Request, work: Coroutine[Any, Any, Document]) -> Document:
    """Return what `work` returns; a caller who goes away ends it. Raises ClientDisconnect."""
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
