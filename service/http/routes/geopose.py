"""`POST /geopose`: the GeoPoseProtocol of OSCP, version 2."""

import base64
import binascii
import time
from contextlib import ExitStack
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import JSONResponse, Response

from panoloc.core.panorama.image_header import IMAGE, check_images
from panoloc.service.answer import Localization
from panoloc.service.errors import InvalidOptionsError, NoPoseError, UploadTooLargeError
from panoloc.service.http.access import caller_of, maps_seen, require
from panoloc.service.http.openapi import json_body, json_part
from panoloc.service.http.routes.localize import checked_options, while_connected
from panoloc.service.http.schemas.geopose import (
    GEOPOSE_REPLY_EXAMPLE,
    GEOPOSE_REQUEST_EXAMPLE,
    CameraReading,
    GeolocationReading,
    GeoPoseAccuracy,
    GeoPoseReply,
    GeoPoseRequest,
)
from panoloc.service.http.schemas.localization import LocalizeOptions
from panoloc.service.http.validation import limited_by, parse_json
from panoloc.service.jobs import QueryImage
from panoloc.service.limits.capacity import Held
from panoloc.service.localizations import LocalizeRequest
from panoloc.service.maps.selection import MapChoice, Place, maps_around
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of
from panoloc.service.settings import Settings

router = APIRouter(tags=["localization"])

_MEDIA_TYPE = "application/vnd.oscp+json; version=2.0"
_ENVELOPE_BYTES = 2**20
_BASE64 = 4 / 3


@router.post(
    "/geopose",
    summary="Find where an image was taken on Earth (OSCP GeoPoseProtocol 2)",
    dependencies=[Depends(require("localize"))],
    response_model=None,
    responses={
        200: {
            "description": "The pose.",
            "content": {
                "application/vnd.oscp+json": {"schema": json_part(GeoPoseReply), "example": GEOPOSE_REPLY_EXAMPLE}
            },
        },
        **error_responses(400, 401, 403, 404, 408, 409, 413, 415, 422, 429, 503, 504),
    },
    openapi_extra=json_body(GeoPoseRequest, GEOPOSE_REQUEST_EXAMPLE),
)
async def post_geopose(
    request: Request,
    map_id: Annotated[
        list[str] | None,
        Query(
            description="Maps to search; default: all with a place on Earth, near the geolocation if the request has one."
        ),
    ] = None,
    tag: Annotated[str | None, Query(description="Instead of `map_id`: all maps with this tag.", max_length=64)] = None,
) -> Response:
    """Return the GeoPose of one image; 404 unless it is `localized`."""
    services = services_of(request)
    with ExitStack() as stack:
        held = services.bytes_in_flight.hold(caller_of(request).id)
        stack.callback(held.release)
        asked = parse_json(GeoPoseRequest, await _body(request, services.settings, held), "body")
        reading = asked.sensorReadings.image()
        image = _image(reading, services.settings)
        options = LocalizeOptions.model_validate({})
        if map_id or tag:
            maps = MapChoice.from_form(map_id or [], [tag] if tag else [], caller_of(request).tenant)
        else:
            maps = maps_around(maps_seen(request), _place(asked.sensorReadings.geolocationReadings))
        query = LocalizeRequest((image,), maps, checked_options(options, services.settings), request.state.request_id)
        answer = await while_connected(request, services.localizations.answer(query))
    return JSONResponse(_reply(asked, answer).model_dump(mode="json"), media_type=_MEDIA_TYPE)


async def _body(request: Request, settings: Settings, held: Held) -> bytes:
    most = int(settings.max_image_bytes * _BASE64) + _ENVELOPE_BYTES
    data = bytearray()
    async for chunk in request.stream():
        held.take(len(chunk))
        data += chunk
        if len(data) > most:
            raise UploadTooLargeError(
                f"expected a request of at most {most:,} bytes (PANOLOC_MAX_IMAGE_BYTES as base64), got more; scale the image down"
            )
    return bytes(data)


def _image(reading: CameraReading, settings: Settings) -> QueryImage:
    camera = reading.camera()
    try:
        # Browsers prepend `data:image/jpeg;base64,`; mail encoders insert line breaks.
        encoded = "".join(reading.imageBytes.rpartition(",")[2].split())
        data = base64.b64decode(encoded, validate=True)
    except (binascii.Error, ValueError) as error:
        at = "sensorReadings.cameraReadings.0.imageBytes"
        raise InvalidOptionsError.of(at, f"expected base64, but {error}; encode the image file") from error
    if len(data) > settings.max_image_bytes:
        raise UploadTooLargeError(
            f"image: expected at most {settings.max_image_bytes:,} bytes (PANOLOC_MAX_IMAGE_BYTES), got {len(data):,}; scale it down"
        )
    with limited_by("PANOLOC_MAX_PIXELS"):
        check_images([data], IMAGE, settings.max_pixels)
    return QueryImage(data, camera=None if camera is None else camera.to_options())


def _place(readings: list[GeolocationReading] | None) -> Place | None:
    """Return the last position of the device."""
    for reading in reversed(readings or []):
        if reading.latitude is not None and reading.longitude is not None:
            return Place(reading.latitude, reading.longitude, reading.accuracy or 0.0)
    return None


def _reply(asked: GeoPoseRequest, answer: Localization) -> GeoPoseReply:
    if answer.status != "localized" or answer.accuracy is None:
        words = "fits several places" if answer.status == "ambiguous" else "fits no place well enough"
        raise NoPoseError(
            f"expected an image of a mapped place, got one that {words}; send an image that shows more of the place"
        )
    if answer.geopose is None:
        raise NoPoseError(
            f"expected a map with a georeference and heights above the ellipsoid, but {answer.map_id} has none; set its georeference "
            "with PATCH /maps/{id}, or POST /localize for a pose in the map"
        )
    return GeoPoseReply(
        id=asked.id or answer.id,
        timestamp=time.time_ns() // 1_000_000,
        type="geopose",
        accuracy=GeoPoseAccuracy(position=answer.accuracy.position_m, orientation=answer.accuracy.orientation_deg),
        geopose=answer.geopose,
    )
