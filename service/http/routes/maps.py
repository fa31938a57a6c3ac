"""List, show, change and delete maps."""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any

import structlog
from fastapi import Depends, Header, Query, Request
from starlette.responses import JSONResponse, Response

from panoloc.service.errors import CacheDownError, InvalidOptionsError, StorageAwayError
from panoloc.service.http.access import maps_seen, note_change, own_map, require
from panoloc.service.http.openapi import api_router, json_body, json_response, nothing_left
from panoloc.service.http.routes.map_links import end_links
from panoloc.service.http.routes.new_scans import read_again
from panoloc.service.http.schemas.examples import MAP_EXAMPLE
from panoloc.service.http.schemas.known_map import Map, MapPage
from panoloc.service.http.schemas.maps import MapPatch
from panoloc.service.http.uploads import read_body
from panoloc.service.http.validation import parse_json
from panoloc.service.jobs import LONGEST_TAG
from panoloc.service.maps.reading import is_read_otherwise, revision_to_read, wanted_reading, with_stated
from panoloc.service.maps.record import MapRecord, map_document
from panoloc.service.maps.selection import check_in_its_system
from panoloc.service.services import Services, services_of

router = api_router("maps")
_log = structlog.get_logger(__name__)
_LAST_PROGRESS = 0.99


@router.get(
    "/maps",
    summary="List maps",
    dependencies=[Depends(require("read"))],
    responses=json_response(MapPage, {"items": [MAP_EXAMPLE], "next_cursor": None}, 401, 403, 422),
)
async def list_maps(
    request: Request,
    tag: Annotated[str | None, Query(description="Only maps with this tag.", max_length=LONGEST_TAG)] = None,
    limit: Annotated[int, Query(ge=1, le=200, description="Maps on a page.")] = 50,
    cursor: Annotated[str | None, Query(description="`next_cursor` of the previous page.", max_length=512)] = None,
) -> Response:
    """Return maps, oldest first, page by page."""
    records, next_cursor = maps_seen(request).page(tag, limit, cursor)
    return JSONResponse({"items": await documents(services_of(request), records), "next_cursor": next_cursor})


@router.get(
    "/maps/{map_id}",
    summary="Show a map and the progress of its registration",
    dependencies=[Depends(require("read"))],
    responses=json_response(Map, MAP_EXAMPLE, 401, 403, 404),
)
async def get_map(request: Request, map_id: str) -> Response:
    """Return one map."""
    services = services_of(request)
    # Behind a balancer each poll may come to another API replica.
    try:
        await services.registry.refresh(map_id)
    except StorageAwayError as error:
        _log.warning("a map is shown in its last known state", map_id=map_id, error=str(error))
    record = maps_seen(request).get(map_id)
    return JSONResponse((await documents(services, [record]))[0], headers=_tag(record))


@router.patch(
    "/maps/{map_id}",
    summary="Change name, tags, place on Earth, or how the scan is read",
    dependencies=[Depends(require("write"))],
    responses=json_response(Map, MAP_EXAMPLE, 400, 401, 403, 404, 408, 412, 413, 422, 503),
    openapi_extra=json_body(MapPatch, {"name": "4th floor", "tags": ["building 7"]}),
)
async def patch_map(
    request: Request,
    map_id: str,
    if_match: Annotated[
        str | None, Header(description="The expected `ETag` or `version` of the map.", max_length=40)
    ] = None,
) -> Response:
    """Change the given fields; the others stay unchanged.

    If another unit or up axis changes the map, the stored scan is registered again as a new revision; if the file of a
    failed revision is damaged or no scan, that of the serving one. The old one answers queries until that is ready.
    What the scan is read as already is only noted, and answers the question about it.

    With `If-Match` the map changes only if it still has that version; otherwise the answer is 412.
    """
    services = services_of(request)
    own_map(request, map_id)
    patch = parse_json(MapPatch, await read_body(request.stream()), "body")
    changes, version = patch.changes(), _wanted_version(if_match)
    given = patch.reading()

    def changed(record: MapRecord) -> MapRecord:
        """Return the map as it is to be."""
        record = replace(record, **changes)
        if changes.get("coordinate_system") and not is_read_otherwise(
            revision_to_read(record), wanted_reading(record, given)
        ):
            check_in_its_system(record)
        return with_stated(record, given)

    record = await services.registry.change(map_id, changed, version)
    reading = wanted_reading(record, given)
    if is_read_otherwise(revision_to_read(record), reading):
        record = await read_again(request, map_id, reading)
    note_change(request, "map changed", map_id)
    return JSONResponse((await documents(services, [record]))[0], headers=_tag(record))


@router.delete(
    "/maps/{map_id}",
    summary="Delete a map with its scan, index and answers",
    dependencies=[Depends(require("write"))],
    status_code=204,
    responses=nothing_left(401, 403, 404, 503),
)
async def delete_map(request: Request, map_id: str) -> Response:
    """Delete a map and cancel its running registration. This cannot be undone."""
    services = services_of(request)
    record = own_map(request, map_id)
    # Without Redis its entries would stay: nothing is deleted then, and the caller tries again.
    await services.cache.check()
    await services.registry.remove(map_id)
    note_change(request, "map deleted", map_id)
    # Only now, because no registration of it begins from here on.
    await services.registrations.cancel(map_id)
    await asyncio.shield(services.cache.forget_map(map_id))
    await asyncio.shield(asyncio.to_thread(services.changes.forget, map_id))
    await asyncio.shield(services.control.forget(map_id))
    services.changed_objects.forget()
    await asyncio.shield(end_links(request, record))
    return Response(status_code=204)


def _tag(record: MapRecord) -> dict[str, str]:
    return {"ETag": f'"{record.version}"'}


def _wanted_version(if_match: str | None) -> int | None:
    """Return the version that a map must have, None for any. Raises InvalidOptionsError."""
    if if_match is None or if_match.strip() == "*":
        return None
    version = if_match.strip().removeprefix("W/").strip('"')  # proxies that compress make it a weak one
    if version.isascii() and version.isdigit():
        return int(version)
    message = f"expected the ETag of a map, or *, got {if_match!r}; GET /maps/{{id}} returns the ETag"
    raise InvalidOptionsError.of("If-Match", message)


async def documents(services: Services, records: Sequence[MapRecord]) -> list[dict[str, Any]]:
    """Return maps as JSON; without Redis their progress is not known, but everything else is."""
    waiting = [record.newest_ref for record in records if record.newest.status == "queued"]
    try:
        progress = await services.cache.get_progress(waiting)
    except CacheDownError as error:
        _log.warning("the progress of maps is unknown", error=str(error))
        unknown = {"status": "queued", "stage": "unknown while Redis does not answer", "progress": 0.0}
        progress = dict.fromkeys(waiting, unknown)
    for ref, stage in services.registrations.waiting_for_room.items():
        progress[ref] = {"status": "indexing", "stage": stage, "progress": _LAST_PROGRESS}
    return [map_document(record, progress.get(record.newest_ref)) for record in records]
