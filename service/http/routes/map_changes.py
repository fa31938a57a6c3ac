"""What changed in a map since its scan: objects, their pictures, reports of them, and cells."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request
from starlette.responses import JSONResponse, Response

from panoloc.core.options import ReportFormat
from panoloc.service.answer import Document
from panoloc.service.errors import ObjectNotFoundError
from panoloc.service.http.access import caller_of, maps_seen, require, while_there
from panoloc.service.http.openapi import api_router, file_response, json_response
from panoloc.service.http.schemas.coordinates import coordinates_of
from panoloc.service.http.schemas.examples import CHANGES_EXAMPLE
from panoloc.service.http.schemas.known_map import MapChanges
from panoloc.service.jobs import MapRef
from panoloc.service.maps.changed_objects import FoundObjects
from panoloc.service.maps.changes import Period
from panoloc.service.maps.control import ControlPoints
from panoloc.service.maps.record import MapRecord, place_on_earth
from panoloc.service.maps.selection import serving_ref
from panoloc.service.services import Services, services_of

router = api_router("maps", Depends(require("read")))

_ERRORS = (401, 403, 404, 409, 422)
_MEDIA_TYPES: dict[ReportFormat, str] = {
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
    "csv": "text/csv; charset=utf-8",
    "geojson": "application/geo+json",
    "bcf": "application/zip",
}
_ENDINGS: dict[ReportFormat, str] = {"bcf": "bcfzip"}  # others are named like their format


async def _period(
    since: Annotated[
        str | None,
        Query(
            description="Only answers from this time on, such as `2026-11-21T12:00:00Z`, or from this day (UTC) on, such as `2026-11-21`."
        ),
    ] = None,
    until: Annotated[
        str | None, Query(description="Only answers up to this time, or up to the end of this day (UTC).")
    ] = None,
) -> Period:
    return Period.between(since, until)


_Asked = Annotated[Period, Depends(_period)]


@router.get(
    "/maps/{map_id}/changes",
    summary="Changes since the scan: objects, and cells",
    responses=json_response(MapChanges, CHANGES_EXAMPLE, *_ERRORS),
)
async def get_changes(request: Request, map_id: str, period: _Asked) -> Response:
    """Return the answers in use, the objects that came, went or moved, and the cells in which answers saw a change.

    All refer to the serving revision. Objects are looked for on request, which takes seconds, and remembered.
    """
    seen = await _Seen.by(request, map_id, period)
    origin_offset = [float(value) for value in _stats(seen.record).get("origin_offset", (0.0, 0.0, 0.0))]
    changes = await asyncio.to_thread(seen.services.changes.document, seen.ref, origin_offset, period)
    if caller_of(request).tenant is not None:
        # Who knows the id of an answer may fetch it, and not all are of the same tenant.
        changes["answers"] = [{**answer, "id": None} for answer in changes["answers"]]
    cells = changes.pop("cells")
    return JSONResponse({**changes, "num_photos": seen.num_photos, "objects": seen.found.objects, "cells": cells})


@router.get(
    "/maps/{map_id}/changes/objects/{object_id}.jpg",
    summary="Photo and scan of an object, side by side",
    response_class=Response,
    responses=file_response(
        "Left the photo that shows it best, right the scan from the same place; of what moved, its new place above its old one.",
        ("image/jpeg",),
        *_ERRORS,
    ),
)
async def get_object_picture(
    request: Request,
    map_id: str,
    object_id: Annotated[str, Path(description="`id` of the object.", max_length=40)],
    period: _Asked,
) -> Response:
    """Return a picture of one object of `GET /maps/{id}/changes` for the same period."""
    seen = await _Seen.by(request, map_id, period)
    picture = seen.found.picture(object_id)
    if picture is None:
        raise ObjectNotFoundError(
            f"expected the id of an object that changed in this period, got {object_id!r}; ids change with the photos, list them again"
        )
    return Response(picture, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})


@router.get(
    "/maps/{map_id}/changes/report",
    summary="A report of what changed, to pass on",
    response_class=Response,
    responses=file_response("The file.", tuple(kind.partition(";")[0] for kind in _MEDIA_TYPES.values()), *_ERRORS),
)
async def get_report(
    request: Request,
    map_id: str,
    period: _Asked,
    format: Annotated[
        ReportFormat,
        Query(
            description="`html` and `pdf` have a plan, the list and pictures; `bcf` is BCF 2.1; `geojson` is in WGS 84."
        ),
    ] = "html",
) -> Response:
    """Return plan, list and pictures of what changed. Where the map's place on Earth is unknown, GeoJSON is in metres and says so."""
    seen = await _Seen.by(request, map_id, period)
    control = await seen.services.control.read(map_id)
    objects = await asyncio.to_thread(_on_earth, seen.found.objects, place_on_earth(seen.record), control)
    found = replace(seen.found, objects=objects)
    async with while_there(request, map_id):
        data = await seen.services.changed_objects.report(seen.ref, found, seen.about(period), format)
    name = f"{map_id}-changes.{_ENDINGS.get(format, format)}"
    how = "inline" if format in ("html", "pdf") else "attachment"
    headers = {"Content-Disposition": f'{how}; filename="{name}"', "X-Content-Type-Options": "nosniff"}
    if format == "html":
        headers["Content-Security-Policy"] = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; sandbox"
    return Response(data, media_type=_MEDIA_TYPES[format], headers=headers)


@dataclass(frozen=True)
class _Seen:
    """A map and what changed in it in a period."""

    services: Services
    record: MapRecord
    ref: MapRef
    num_photos: int
    found: FoundObjects

    @classmethod
    async def by(cls, request: Request, map_id: str, period: Period) -> "_Seen":
        services, record = services_of(request), maps_seen(request).get(map_id)
        ref = serving_ref(record)
        photos = await asyncio.to_thread(services.changes.photos, ref, period)
        async with while_there(request, map_id):
            found = await services.changed_objects.find(ref, photos, _stats(record))
        return cls(services, record, ref, len(photos), found)

    def about(self, period: Period) -> dict[str, Any]:
        """Return what a report says of the map."""
        first, last = (f"{time:%Y-%m-%d %H:%M} UTC" if time else None for time in (period.since, period.until))
        words = " ".join(f"{name} {text}" for name, text in (("from", first), ("until", last)) if text)
        photos = f"{self.num_photos} photo{'s' * (self.num_photos != 1)}"
        when = f" {words}" if words else ""
        found = f"Found in {photos}{when}, compared with the scan." if self.num_photos else f"No photos are kept{when}."
        return {
            "title": self.record.name,
            "num_photos": self.num_photos,
            "period": found,
            "made_at": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        }


def _on_earth(objects: Sequence[Document], place: Mapping[str, Any], control: ControlPoints) -> list[Document]:
    """Return objects with `grid`, `from_grid` and `wgs84`, as reports take them."""
    placed = []
    for each in objects:
        now = coordinates_of(place, control, tuple(each["center_m"]))
        before = coordinates_of(place, control, tuple(each["from_m"])) if each["from_m"] else now | {"grid": None}
        placed.append({**each, "grid": now["grid"], "from_grid": before["grid"], "wgs84": now["wgs84"]})
    return placed


def _stats(record: MapRecord) -> dict[str, Any]:
    return (record.serving.stats if record.serving else None) or {}
