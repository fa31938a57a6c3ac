"""Control points of a map: store them, and compare."""

import asyncio

from fastapi import Depends, Request
from starlette.responses import JSONResponse, Response

from panoloc.service.http.access import maps_seen, note_change, own_map, require
from panoloc.service.http.openapi import api_router, json_body, json_response
from panoloc.service.http.schemas.control import CONTROL_BODY_EXAMPLE, CONTROL_EXAMPLE, ControlBody, ControlReport
from panoloc.service.http.uploads import read_body
from panoloc.service.http.validation import named_field, parse_json
from panoloc.service.maps.control import ControlPoints, control_document
from panoloc.service.maps.record import MapRecord
from panoloc.service.maps.selection import serving_ref
from panoloc.service.services import services_of

router = api_router("maps")


@router.get(
    "/maps/{map_id}/control-points",
    summary="The control points of a map, and how far it is off them",
    dependencies=[Depends(require("read"))],
    responses=json_response(ControlReport, CONTROL_EXAMPLE, 401, 403, 404, 409, 422, 503),
)
async def get_control_points(request: Request, map_id: str) -> Response:
    """Return the residuals of the map as it stands, and after the best turn about the vertical and shift."""
    record = maps_seen(request).get(map_id)
    return await _report(record, await services_of(request).control.read(map_id))


@router.put(
    "/maps/{map_id}/control-points",
    summary="Set the control points of a map, and compare",
    dependencies=[Depends(require("write"))],
    responses=json_response(ControlReport, CONTROL_EXAMPLE, 400, 401, 403, 404, 408, 409, 413, 422, 503),
    openapi_extra=json_body(ControlBody, CONTROL_BODY_EXAMPLE),
)
async def put_control_points(request: Request, map_id: str) -> Response:
    """Replace all points; none deletes them. The map itself changes only by `PATCH /maps/{id}`, such as with `fit.georeference`."""
    record = own_map(request, map_id)
    body = parse_json(ControlBody, await read_body(request.stream()), "body")
    ref = serving_ref(record)
    with named_field():
        sent = body.to_points()
        # Before they are stored: what cannot be compared is refused.
        await asyncio.to_thread(control_document, record, sent)
    kept = await services_of(request).control.write(ref, sent)
    note_change(request, "map changed", map_id)
    return await _report(record, kept)


async def _report(record: MapRecord, kept: ControlPoints) -> Response:
    with named_field():
        return JSONResponse(await asyncio.to_thread(control_document, record, kept))
