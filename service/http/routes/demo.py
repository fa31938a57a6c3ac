"""A made-up room to try everything with: its scan and a panorama of it."""

from typing import Any

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from service.http.access import require
from service.problems import error_responses
from service.services import services_of

router = APIRouter(tags=["operations"], dependencies=[Depends(require("read"))])

_ERRORS = error_responses(401, 403, 503)


def _file(description: str, media_type: str) -> dict[int | str, dict[str, Any]]:
    content = {media_type: {"schema": {"type": "string", "format": "binary"}}}
    return {200: {"description": description, "content": content}, **_ERRORS}


@router.get(
    "/demo/room.ply",
    summary="The scan of a synthetic room",
    response_class=Response,
    responses=_file("A coloured point cloud.", "application/ply"),
)
async def get_room(request: Request) -> Response:
    """Return a scan to register; made when it is first asked for, which takes some seconds."""
    return Response(await services_of(request).demo_room.file("room.ply"), media_type="application/ply")


@router.get(
    "/demo/panorama.jpg",
    summary="A panorama of the synthetic room, taken after furniture was moved",
    response_class=Response,
    responses=_file("An equirectangular panorama.", "image/jpeg"),
)
async def get_panorama(request: Request) -> Response:
    """Return a panorama to localize in the map of that scan."""
    return Response(await services_of(request).demo_room.file("panorama.jpg"), media_type="image/jpeg")
