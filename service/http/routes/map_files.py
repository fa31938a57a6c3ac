"""What viewers show of a map: its picture from above, its points, its starts."""

import asyncio
import json
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal, TypeVar

from fastapi import Depends, Query, Request
from starlette.responses import JSONResponse, Response, StreamingResponse

from panoloc.service.errors import StoredFileMissingError
from panoloc.service.http.access import maps_seen, require
from panoloc.service.http.openapi import api_router, file_response, json_response
from panoloc.service.http.schemas.coordinates import Coordinates, coordinates_of
from panoloc.service.http.schemas.examples import COORDINATES_EXAMPLE
from panoloc.service.http.schemas.known_map import MapStarts
from panoloc.service.jobs import MAX_SAMPLE_POINTS, MapRef
from panoloc.service.maps.point_sample import PlySample
from panoloc.service.maps.record import key_of, place_on_earth
from panoloc.service.maps.selection import serving_ref
from panoloc.service.problems import error_responses
from panoloc.service.services import services_of
from panoloc.service.storage import Storage

router = api_router("maps", Depends(require("read")))

Found = TypeVar("Found")
_Metres = Annotated[float, Query(description="Metres in the map's own frame.", ge=-1e8, le=1e8, allow_inf_nan=False)]
_PLY_TYPE = "application/ply"
_MOST_JSON_POINTS = 200_000  # more would take seconds and gigabytes to write
_ERRORS = (401, 403, 404, 409)
_STARTS_EXAMPLE = {
    "map_id": "map_2xk7q0v9m3d1c8fa",
    "revision": 1,
    "num_starts": 1,
    "starts": [{"position_m": [1.2, 0.3, 1.5], "leaf_size_m": 0.5}],
}
_POINTS_RESPONSE: dict[str, Any] = {
    "description": "Coloured points in the map's own frame, metres.",
    "content": {
        _PLY_TYPE: {"schema": {"type": "string", "format": "binary"}},
        "application/json": {
            "example": {"num_points": 1, "positions_m": [[1.2, 0.3, 1.5]], "colors": [[200, 180, 160]]},
            "schema": {
                "type": "object",
                "required": ["num_points", "positions_m", "colors"],
                "properties": {
                    "num_points": {"type": "integer"},
                    "positions_m": {"type": "array", "items": {"type": "array", "items": {"type": "number"}}},
                    "colors": {"type": "array", "items": {"type": "array", "items": {"type": "integer"}}},
                },
            },
        },
    },
}


@router.get(
    "/maps/{map_id}/preview.png",
    summary="The scan from above",
    response_class=Response,
    responses=file_response("The picture.", ("image/png",), *_ERRORS),
)
async def get_preview(
    request: Request,
    map_id: str,
    revision: Annotated[
        int | None,
        Query(description="Not read: another number lets a browser load the picture anew."),
    ] = None,
) -> Response:
    """Return a picture of the serving revision."""
    data, ref = await _file(request, map_id, "preview.png")
    return Response(data, media_type="image/png", headers=_caching(ref))


@router.get(
    "/maps/{map_id}/points",
    summary="A thinned coloured cloud",
    response_class=Response,
    responses={200: _POINTS_RESPONSE, **error_responses(401, 403, 404, 409, 422)},
)
async def get_points(
    request: Request,
    map_id: str,
    max_points: Annotated[
        int, Query(ge=1, le=MAX_SAMPLE_POINTS, description=f"Largest number of points; as JSON {_MOST_JSON_POINTS:,}.")
    ] = 100_000,
    format: Annotated[
        Literal["ply", "json"] | None,
        Query(description="Overrides `Accept`, which takes `application/ply` (the default) or `application/json`."),
    ] = None,
) -> Response:
    """Return a uniform sample of the map's points as binary PLY, or as JSON on request.

    The points come in random order: a viewer that draws points on arrival shows the whole scan, ever more densely.
    """
    storage = services_of(request).storage
    sample, ref = await _stored(request, map_id, "points.ply", partial(_open_sample, storage))
    wants_json = format == "json" or (format is None and _prefers_json(request.headers.get("accept", "")))
    headers = {**_caching(ref), "Vary": "Accept"}
    if wants_json:
        sample = sample.first(min(max_points, _MOST_JSON_POINTS))
        text = await asyncio.to_thread(lambda: json.dumps(sample.to_json()))
        return Response(text, media_type="application/json", headers=headers)
    sample = sample.first(max_points)
    headers["Content-Disposition"] = f'attachment; filename="{map_id}.ply"'
    headers["Content-Length"] = str(sample.num_bytes)
    return StreamingResponse(sample.blocks(), media_type=_PLY_TYPE, headers=headers)


@router.get(
    "/maps/{map_id}/starts",
    summary="The starts of the search",
    responses=json_response(MapStarts, _STARTS_EXAMPLE, *_ERRORS),
)
async def get_starts(request: Request, map_id: str) -> Response:
    """Return the camera positions that a search in this map tries."""
    data, ref = await _file(request, map_id, "starts.json")
    starts = json.loads(data)
    body = {"map_id": ref.id, "revision": ref.revision, "num_starts": len(starts), "starts": starts}
    return JSONResponse(body, headers=_caching(ref))


@router.get(
    "/maps/{map_id}/coordinates",
    summary="A position in the map, on its grid and on WGS 84",
    responses=json_response(Coordinates, COORDINATES_EXAMPLE, 401, 403, 404, 422),
)
async def get_coordinates(request: Request, map_id: str, x: _Metres, y: _Metres, z: _Metres) -> Response:
    """Return where a position of the map's own frame is on Earth; null where the map has no place there."""
    record = maps_seen(request).get(map_id)
    control = await services_of(request).control.read(map_id)
    return JSONResponse(await asyncio.to_thread(coordinates_of, place_on_earth(record), control, (x, y, z)))


async def _file(request: Request, map_id: str, name: str) -> tuple[bytes, MapRef]:
    return await _stored(request, map_id, name, services_of(request).storage.read)


def _open_sample(storage: Storage, key: str) -> PlySample:
    with storage.local_copy(key) as path:
        return PlySample.parse(path.open("rb"), key)


async def _stored(request: Request, map_id: str, name: str, read: Callable[[str], Found]) -> tuple[Found, MapRef]:
    """Return what `read` makes of a file of the revision that answers queries, by its key, and the revision."""
    ref = serving_ref(maps_seen(request).get(map_id))
    while True:
        try:
            return await asyncio.to_thread(read, key_of(ref, name)), ref
        except StoredFileMissingError:
            # The revision may have been replaced, or the map deleted, since the request came.
            former, ref = ref, serving_ref(maps_seen(request).get(map_id))
            if ref == former:
                raise


def _prefers_json(accept: str) -> bool:
    """Tell whether JSON is named and PLY is not; quality values are not weighed."""
    kinds = {part.partition(";")[0].strip().lower() for part in accept.split(",")}
    return "application/json" in kinds and _PLY_TYPE not in kinds


def _caching(ref: MapRef) -> dict[str, str]:
    # The file behind a revision never changes, but a new revision may serve any moment. Weak, because it may be sent compressed or not.
    return {"ETag": f'W/"{ref.id}-{ref.revision}"', "Cache-Control": "private, no-cache"}
