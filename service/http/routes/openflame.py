"""The protocol of OpenFLAME: each map is a map server under the path of its id."""

from contextlib import ExitStack
from typing import Any

from fastapi import APIRouter, Depends, Request
from starlette.convertors import Convertor, register_url_convertor

from panoloc.core.panorama.image_header import IMAGE, KNOWN_FORMATS, check_images
from panoloc.service.answer import Localization
from panoloc.service.http.access import caller_of, maps_seen, require
from panoloc.service.http.openapi import files_part, multipart
from panoloc.service.http.query_images import query_images
from panoloc.service.http.routes.localize import checked_options, while_connected
from panoloc.service.http.schemas.geopose import OpenFlameAnswer, OpenFlameCapabilities
from panoloc.service.http.schemas.localization import LocalizeOptions
from panoloc.service.http.spool import PartRule
from panoloc.service.http.uploads import read_form
from panoloc.service.http.validation import limited_by
from panoloc.service.localizations import LocalizeRequest
from panoloc.service.maps.selection import MapChoice
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of

router = APIRouter(tags=["localization"])

_AFRAME_POSE = "aframe_camera_matrix_world"
_FOUND_EXAMPLE: dict[str, Any] = {
    "success": True,
    "pose": [
        [-0.620609899, 0.117343287, -0.775289563, -2.5],
        [-0.080922756, 0.973874809, 0.212177672, 1.6],
        [0.7799326, 0.194418132, -0.594900605, 1.25],
        [0, 0, 0, 1],
    ],
    "confidence": 0.93,
}
_CAPABILITIES_EXAMPLE: dict[str, Any] = {
    "commonName": "3rd floor",
    "iconURL": "http://127.0.0.1:8000/maps/map_2xk7q0v9m3d1c8fa/preview.png",
    "services": [
        {
            "name": "localization",
            "url": "http://127.0.0.1:8000/map_2xk7q0v9m3d1c8fa/localize/image",
            "types": ["image"],
        }
    ],
}


class _MapIdConvertor(Convertor[str]):
    """Matches ids of maps alone, so that these routes hide no other path of the service."""

    regex = "map_[0-9A-Za-z]+"

    def convert(self, value: str) -> str:
        """Return the id in a path."""
        return value

    def to_string(self, value: str) -> str:
        """Return the id for a path."""
        return value


register_url_convertor("map_id", _MapIdConvertor())


@router.post(
    "/{map_id:map_id}/localize/image",
    summary="Find where an image was taken (OpenFLAME)",
    dependencies=[Depends(require("localize"))],
    responses={
        200: {"content": {"application/json": {"example": _FOUND_EXAMPLE}}},
        **error_responses(400, 401, 403, 404, 408, 409, 413, 415, 422, 429, 503, 504),
    },
    openapi_extra=multipart(
        {
            "image": files_part(f"A panorama or a photo; {KNOWN_FORMATS}.", 1),
            _AFRAME_POSE: {"type": "string", "description": "The client's estimate of its pose; not used."},
        },
        ["image"],
        {"a photo": {"value": {"image": ["(the bytes)"]}}},
    ),
)
async def localize_image(request: Request, map_id: str) -> OpenFlameAnswer:
    """Return the pose of an image, if it is `localized`, else `success: false`."""
    services = services_of(request)
    settings = services.settings
    rules = {"image": PartRule(settings.max_image_bytes, "PANOLOC_MAX_IMAGE_BYTES"), _AFRAME_POSE: PartRule()}
    with ExitStack() as stack:
        held = services.bytes_in_flight.hold(caller_of(request).id)
        stack.callback(held.release)
        with await read_form(request.stream(), request.headers, rules, held=held) as form:
            images = form.all(IMAGE.name)
        options = LocalizeOptions.model_validate({"frame": "webxr"})
        query = query_images(images, [], options)
        with limited_by("PANOLOC_MAX_PIXELS"):
            check_images(images, IMAGE, settings.max_pixels)
        asked = LocalizeRequest(
            query,
            MapChoice((map_id,), None, caller_of(request).tenant),
            checked_options(options, settings),
            request.state.request_id,
        )
        answer = await while_connected(request, services.localizations.answer(asked))
    return _reply(answer)


@router.get(
    "/{map_id:map_id}/capabilities",
    summary="Capabilities of an OpenFLAME map server",
    dependencies=[Depends(require("read"))],
    responses={
        200: {"content": {"application/json": {"example": _CAPABILITIES_EXAMPLE}}},
        **error_responses(401, 403, 404),
    },
)
@router.get(
    "/{map_id:map_id}/capabilities/",
    dependencies=[Depends(require("read"))],
    include_in_schema=False,
)
async def get_capabilities(request: Request, map_id: str) -> OpenFlameCapabilities:
    """Return the name of the map, its picture, and the URL that localizes images in it."""
    record = maps_seen(request).get(map_id)
    service = {"name": "localization", "url": str(request.url_for("localize_image", map_id=map_id)), "types": ["image"]}
    icon = str(request.url_for("get_preview", map_id=map_id))
    return OpenFlameCapabilities(commonName=record.name, iconURL=icon, services=[service])


def _reply(answer: Localization) -> OpenFlameAnswer:
    if answer.status != "localized" or answer.pose is None:
        return OpenFlameAnswer(success=False, pose=None, confidence=0)
    # From the world of WebXR (x, z, −y of the map) to that of A-Frame (y, z, x); the camera's axes are the same.
    east, up, south, last = answer.pose.map_from_camera.matrix
    return OpenFlameAnswer(
        success=True, pose=[[0.0 - value for value in south], up, east, last], confidence=answer.confidence
    )
