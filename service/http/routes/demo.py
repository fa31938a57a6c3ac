"""A made-up room to try everything with: its scan and a panorama of it."""

from fastapi import APIRouter, Depends, Request
from starlette.responses import Response

from panoloc.service.http.access import require
from panoloc.service.http.responses import file_response
from panoloc.service.services import services_of

router = APIRouter(tags=["operations"], dependencies=[Depends(require("read"))])


@router.get(
    "/demo/room.ply",
    summary="The scan of a synthetic room",
    response_class=Response,
    responses=file_response("A coloured point cloud.", ("application/ply",), 401, 403, 503),
)
async def get_room(request: Request) -> Response:
    """Return a scan to register. The first request generates it, which takes some seconds."""
    return Response(await services_of(request).demo_room.file("room.ply"), media_type="application/ply")


@router.get(
    "/demo/panorama.jpg",
    summary="A panorama of the synthetic room, taken after furniture was moved",
    response_class=Response,
    responses=file_response("An equirectangular panorama.", ("image/jpeg",), 401, 403, 503),
)
async def get_panorama(request: Request) -> Response:
    """Return a panorama to localize in the map of that scan."""
    return Response(await services_of(request).demo_room.file("panorama.jpg"), media_type="image/jpeg")
