"""Links that open a map on phones."""

import asyncio
import io

import segno
from fastapi import Depends, Request
from starlette.responses import JSONResponse, Response

from panoloc.service.http.access import note_change, own_map, require
from panoloc.service.http.openapi import api_router, json_body, json_response
from panoloc.service.http.schemas.examples import LINK_EXAMPLE
from panoloc.service.http.schemas.maps import LinkRequest, MapLink
from panoloc.service.http.uploads import read_body
from panoloc.service.http.validation import parse_json
from panoloc.service.keys.caller import Scope
from panoloc.service.maps.record import MapRecord
from panoloc.service.services import services_of

router = api_router("maps")

# Phones fetch the map, and localize in it.
_SCOPES: tuple[Scope, ...] = ("read", "localize")


@router.post(
    "/maps/{map_id}/links",
    summary="Make a link and a QR code for phones",
    dependencies=[Depends(require("write"))],
    responses=json_response(MapLink, LINK_EXAMPLE, 400, 401, 403, 404, 408, 413, 422, 503),
    openapi_extra=json_body(LinkRequest, {"service_url": "https://scanner.local:8000"}),
)
async def post_link(request: Request, map_id: str) -> Response:
    """Return a link to the page on which a phone finds its place in the map.

    Where the service requires keys, the link carries a new one for this map alone; `panoloc keys revoke` ends it.
    """
    record = own_map(request, map_id)
    given = parse_json(LinkRequest, await read_body(request.stream()), "body")
    url, key_id = f"{str(given.service_url).rstrip('/')}/m/{map_id}", None
    if services_of(request).settings.keys.required:
        key_id, key = await _new_key(request, record)
        url += f"#key={key}"
    picture = io.BytesIO()
    segno.make_qr(url).save(picture, kind="svg", xmldecl=False, omitsize=True, light="white")
    body = {"url": url, "key_id": key_id, "qr_svg": picture.getvalue().decode()}
    return JSONResponse(body, headers={"Cache-Control": "no-store"})


async def end_links(request: Request, record: MapRecord) -> None:
    """Revoke the keys of all links to a map."""
    file = services_of(request).settings.keys.file
    for key in await asyncio.to_thread(file.read):
        if key.tenant == record.visitors and key.revoked_at is None:
            await asyncio.to_thread(file.revoke, key.id)
            note_change(request, "key revoked", key.id)


async def _new_key(request: Request, record: MapRecord) -> tuple[str, str]:
    """Make a key of a tenant that sees only this map; return its id and text."""
    keys = services_of(request).settings.keys
    made, text = await asyncio.to_thread(keys.file.make, f"visitors of {record.id}", _SCOPES, record.visitors)
    keys.look_again()
    note_change(request, "key made", made.id)
    return made.id, text
