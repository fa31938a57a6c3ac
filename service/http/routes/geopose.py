"""Protocols of others: the GeoPoseProtocol of OSCP (version 2), and OpenFLAME, for which each map is a map server under
the path of its id."""

import base64
import time
from contextlib import ExitStack
from typing import Annotated

from fastapi import Depends, Query, Request
from starlette.convertors import StringConvertor, register_url_convertor
from starlette.responses import JSONResponse, Response

from panoloc.core.image.image_header import IMAGE, KNOWN_FORMATS
from panoloc.service.answer import Localization
from panoloc.service.errors import InvalidOptionsError, NoPoseError, UploadTooLargeError
from panoloc.service.http.access import caller_of, maps_seen, require
from panoloc.service.http.openapi import api_router, files_part, json_body, json_part, multipart
from panoloc.service.http.routes.localize import QUERY_ERRORS, query_of, while_connected
from panoloc.service.http.schemas.examples import GEOPOSE_REQUEST_EXAMPLE
from panoloc.service.http.schemas.geopose import (
    CameraReading,
    GeolocationReading,
    GeoPoseAccuracy,
    GeoPoseReply,
    GeoPoseRequest,
    OpenFlameAnswer,
    OpenFlameCapabilities,
)
from panoloc.service.http.schemas.queries import LocalizeOptions
from panoloc.service.http.uploads import PartRule, read_body, read_form
from panoloc.service.http.validation import parse_json
from panoloc.service.maps.selection import MapChoice, Place, maps_around
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of

router = api_router("localization")

_OSCP_TYPE = "application/vnd.oscp+json"
_ENVELOPE_BYTES = 2**20
_BASE64 = 4 / 3
_AFRAME_POSE = "aframe_camera_matrix_world"


class _MapIdConvertor(StringConvertor):
    """Matches ids of maps alone, so that the paths of OpenFLAME hide no other path of the service."""

    regex = "map_[0-9A-Za-z]+"


register_url_convertor("map_id", _MapIdConvertor())


@router.post(
    "/geopose",
    summary="Find where an image was taken on Earth (OSCP GeoPoseProtocol 2)",
    dependencies=[Depends(require("localize"))],
    response_model=None,
    responses={
        200: {"description": "The pose.", "content": {_OSCP_TYPE: {"schema": json_part(GeoPoseReply)}}},
        **error_responses(*QUERY_ERRORS),
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
    max_bytes = services.settings.max_image_bytes
    with ExitStack() as stack:
        held = services.bytes_in_flight.hold(caller_of(request).id)
        stack.callback(held.release)
        most = int(max_bytes * _BASE64) + _ENVELOPE_BYTES
        body = await read_body(request.stream(), most, "PANOLOC_MAX_IMAGE_BYTES as base64", held)
        asked = parse_json(GeoPoseRequest, body, "body")
        reading = asked.sensorReadings.image()
        camera = reading.camera()
        options = LocalizeOptions.model_validate({"cameras": None if camera is None else [camera]})
        if map_id or tag:
            maps = MapChoice.from_form(map_id or [], [tag] if tag else [], caller_of(request).tenant)
        else:
            maps = maps_around(maps_seen(request), _place(asked.sensorReadings.geolocationReadings or []))
        query = query_of(request, [_image(reading, max_bytes)], options, maps)
        answer = await while_connected(request, services.localizations.answer(query))
    reply = _geopose_reply(asked, answer).model_dump(mode="json")
    return JSONResponse(reply, media_type=f"{_OSCP_TYPE}; version=2.0")


@router.post(
    "/{map_id:map_id}/localize/image",
    summary="Find where an image was taken (OpenFLAME)",
    dependencies=[Depends(require("localize"))],
    responses=error_responses(*QUERY_ERRORS),
    openapi_extra=multipart(
        {
            "image": files_part(f"A panorama or a photo; {KNOWN_FORMATS}.", 1),
            _AFRAME_POSE: {"type": "string", "description": "The client's estimate of its pose; not used."},
        },
        ["image"],
    ),
)
async def localize_image(request: Request, map_id: str) -> OpenFlameAnswer:
    """Return the pose of an image, if it is `localized`, else `success: false`."""
    services = services_of(request)
    rules = {
        "image": PartRule(services.settings.max_image_bytes, "PANOLOC_MAX_IMAGE_BYTES"),
        _AFRAME_POSE: PartRule(),
    }
    maps = MapChoice((map_id,), None, caller_of(request).tenant)
    with ExitStack() as stack:
        held = services.bytes_in_flight.hold(caller_of(request).id)
        stack.callback(held.release)
        async with read_form(request.stream(), request.headers, rules, held=held) as form:
            options = LocalizeOptions.model_validate({"frame": "webxr"})
            query = query_of(request, form.fields[IMAGE.name], options, maps)
        answer = await while_connected(request, services.localizations.answer(query))
    if answer.status != "localized" or answer.pose is None:
        return OpenFlameAnswer(success=False, pose=None, confidence=0)
    # From the world of WebXR (x, z, −y of the map) to that of A-Frame (y, z, x); the camera's axes are the same.
    east, up, south, last = answer.pose.map_from_camera.matrix
    pose = [[0.0 - value for value in south], up, east, last]
    return OpenFlameAnswer(success=True, pose=pose, confidence=answer.confidence)


@router.get(
    "/{map_id:map_id}/capabilities",
    summary="Capabilities of an OpenFLAME map server",
    dependencies=[Depends(require("read"))],
    responses=error_responses(401, 403, 404),
)
@router.get("/{map_id:map_id}/capabilities/", dependencies=[Depends(require("read"))], include_in_schema=False)
async def get_capabilities(request: Request, map_id: str) -> OpenFlameCapabilities:
    """Return the name of the map, its picture, and the URL that localizes images in it."""
    record = maps_seen(request).get(map_id)
    service = {"name": "localization", "url": str(request.url_for("localize_image", map_id=map_id)), "types": ["image"]}
    icon = str(request.url_for("get_preview", map_id=map_id))
    return OpenFlameCapabilities(commonName=record.name, iconURL=icon, services=[service])


def _image(reading: CameraReading, max_bytes: int) -> bytes:
    try:
        # Browsers prepend `data:image/jpeg;base64,`; mail encoders insert line breaks.
        encoded = "".join(reading.imageBytes.rpartition(",")[2].split())
        data = base64.b64decode(encoded, validate=True)
    except ValueError as error:
        at = "sensorReadings.cameraReadings.0.imageBytes"
        raise InvalidOptionsError.of(at, f"expected base64, but {error}; encode the image file") from error
    if len(data) > max_bytes:
        raise UploadTooLargeError(
            f"image: expected at most {max_bytes:,} bytes (PANOLOC_MAX_IMAGE_BYTES), got {len(data):,}; scale it down"
        )
    return data


def _place(readings: list[GeolocationReading]) -> Place | None:
    """Return the last position of the device."""
    for reading in reversed(readings):
        if reading.latitude is not None and reading.longitude is not None:
            return Place(reading.latitude, reading.longitude, reading.accuracy or 0.0)
    return None


def _geopose_reply(asked: GeoPoseRequest, answer: Localization) -> GeoPoseReply:
    if answer.status != "localized" or answer.accuracy is None:
        words = (
            "shows what looks the same from several places"
            if answer.status == "ambiguous"
            else "fits no place well enough"
        )
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
