"""Upload a scan: as a new map, or as a new revision of one."""

import asyncio
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path, PurePosixPath

from fastapi import Depends, Request
from starlette.responses import JSONResponse, Response

from panoloc.core import options
from panoloc.core.scan.format_detection import KNOWN_FORMATS, extension_of, format_of
from panoloc.core.scan.ply.header import check_ply_file
from panoloc.core.scan.zip_opening import unpacked_bytes
from panoloc.service.errors import InvalidOptionsError
from panoloc.service.http.access import caller_of, hold_upload_place, note_change, own_map, require
from panoloc.service.http.openapi import accepted_response, api_router, binary_part, json_part, multipart
from panoloc.service.http.schemas.examples import MAP_OPTIONS_EXAMPLE, QUEUED_MAP_EXAMPLE
from panoloc.service.http.schemas.known_map import Map
from panoloc.service.http.schemas.maps import MapOptions, ScanOptions, name_of_file
from panoloc.service.http.uploads import Form, PartRule, SpooledFile, read_form
from panoloc.service.http.validation import limited_by, parse_json
from panoloc.service.jobs import MapRef, RegisterOptions, new_id, now
from panoloc.service.limits.registration_limits import MAX_COUNTED_BYTES
from panoloc.service.maps.reading import revision_to_read
from panoloc.service.maps.record import MapRecord, Revision, map_document
from panoloc.service.services import Services, services_of
from panoloc.service.storage import Storage
from panoloc.service.storage.disk import disk_errors

router = api_router("maps")

_RETRY_AFTER_S = 1
_SCAN_PART = binary_part(f"The scan: {KNOWN_FORMATS}, with colours.")
_ACCEPTED = "The scan is stored; poll the map until it is ready."


@router.post(
    "/maps",
    summary="Register a scan",
    dependencies=[Depends(require("write")), Depends(hold_upload_place)],
    status_code=202,
    responses=accepted_response(Map, QUEUED_MAP_EXAMPLE, _ACCEPTED, "map", 400, 401, 403, 408, 409, 413, 415, 422, 503),
    openapi_extra=multipart(
        {"file": _SCAN_PART, "options": json_part(MapOptions)},
        ["file"],
        {"a floor": {"value": {"file": "(the bytes of office.ply)", "options": MAP_OPTIONS_EXAMPLE}}},
    ),
)
async def post_map(request: Request) -> Response:
    """Store a scan durably, then build a map from it in the background."""
    services = services_of(request)
    services.registry.check_room()
    async with _form(request, services) as form:
        options = parse_json(MapOptions, form.options(), "options")
        scan = await _checked_scan(form, services)
        ref = MapRef(new_id("map"), 1)
        try:
            revision = await _store(services, ref, scan, options.to_options())
            record = MapRecord(
                id=ref.id,
                name=options.name or name_of_file(scan.name) or ref.id,
                created_at=(created_at := now()),
                updated_at=created_at,
                newest=revision,
                tags=options.tags,
                georeference=None if options.georeference is None else options.georeference.model_dump(mode="json"),
                coordinate_system=options.coordinate_system,
                geoid_undulation_m=options.geoid_undulation_m,
                owner=caller_of(request).tenant,
            )
            record = await services.registry.add(record)
        except BaseException:
            await services.registry.remove_revision(ref)
            raise
    note_change(request, "map registered", record.id)
    return _accepted(_begun(request, record))


@router.put(
    "/maps/{map_id}/scan",
    summary="Replace a map's scan with a newer one",
    dependencies=[Depends(require("write")), Depends(hold_upload_place)],
    status_code=202,
    responses=accepted_response(Map, QUEUED_MAP_EXAMPLE, _ACCEPTED, "map", 400, 401, 403, 404, 408, 413, 415, 422, 503),
    openapi_extra=multipart({"file": _SCAN_PART, "options": json_part(ScanOptions)}, ["file"]),
)
async def put_scan(request: Request, map_id: str) -> Response:
    """Store a new revision under the same id. The old one answers queries until the new one is ready.

    Options that are left out keep their values of the previous revision.
    """
    services = services_of(request)
    own_map(request, map_id)
    async with _form(request, services) as form:
        given = parse_json(ScanOptions, form.options(), "options")
        scan = await _checked_scan(form, services)

        async def store(ref: MapRef, record: MapRecord) -> Revision:
            return await _store(services, ref, scan, given.over(record.newest.options))

        return _accepted(await _replaced(request, map_id, store))


async def read_again(request: Request, map_id: str, reading: options.ScanOptions) -> MapRecord:
    """Register the stored scan of a map again, read in another way, as a new revision; return the map."""
    services = services_of(request)

    async def store(ref: MapRef, record: MapRecord) -> Revision:
        former = revision_to_read(record)
        copy = await asyncio.to_thread(_copied, services.storage, former.scan_key)
        try:
            name = PurePosixPath(former.scan_key).name
            key = await services.registry.adopt_scan(ref, name, copy, former.scan_sha256)
        finally:
            copy.unlink(missing_ok=True)
        changed = replace(former.options, scan=reading)
        return Revision(
            ref.revision, key, former.scan_name, former.scan_bytes, former.scan_sha256, changed, former.unpacked_bytes
        )

    return await _replaced(request, map_id, store)


def _copied(storage: Storage, key: str) -> Path:
    """Return a copy of a stored file in the folder for uploads."""
    copy = storage.spool_folder() / new_id("copy")
    with storage.local_copy(key, checked=False) as path, disk_errors():
        shutil.copyfile(path, copy)
    return copy


async def _replaced(
    request: Request, map_id: str, store: Callable[[MapRef, MapRecord], Awaitable[Revision]]
) -> MapRecord:
    """Store a new revision of a map and begin its registration; return the map. store: makes it from the map."""
    services = services_of(request)
    async with services.registry.new_revision(map_id) as ref:
        try:
            revision = await store(ref, services.registry.get(map_id))
            services.registry.check_new_revision(ref)
            replaced, record = await _replace(services, map_id, revision)
        except BaseException:
            await services.registry.remove_revision(ref)
            raise
    note_change(request, "scan replaced", map_id)
    await services.registrations.cancel(map_id, keep=record.newest_ref)
    record = _begun(request, services.registry.get(map_id))
    for each in (replaced, ref):
        await services.registrations.forget(each)
    return record


async def _replace(services: Services, map_id: str, revision: Revision) -> tuple[MapRef, MapRecord]:
    """Make a revision the newest of its map, unless a newer one came meanwhile; return the one before, and the map."""
    replaced: list[MapRef] = []

    def update(record: MapRecord) -> MapRecord:
        replaced.append(record.newest_ref)
        return replace(record, newest=revision) if revision.number > record.newest.number else record

    record = await services.registry.change(map_id, update)
    return replaced[0], record


@asynccontextmanager
async def _form(request: Request, services: Services) -> AsyncIterator[Form]:
    most = services.settings.max_upload_bytes
    rules = {
        "file": PartRule(most, "PANOLOC_MAX_UPLOAD_BYTES", spooled=True, check_head=_check_head),
        "options": PartRule(),
    }
    folder = await asyncio.to_thread(services.storage.spool_folder)
    async with read_form(request.stream(), request.headers, rules, folder) as form:
        yield form


def _check_head(head: bytes, name: str) -> None:
    format_of(head, extension_of(name))


async def _checked_scan(form: Form, services: Services) -> SpooledFile:
    if not form.files["file"]:
        raise InvalidOptionsError.of(
            "file", "expected the scan in a part of this name, got none; send -F file=@scan.ply"
        )
    scan, reading = form.files["file"][0], options.ScanOptions(max_points=services.settings.max_points)
    with limited_by("PANOLOC_MAX_POINTS"):
        await asyncio.to_thread(check_ply_file, scan.path, reading)
    return scan


async def _store(services: Services, ref: MapRef, scan: SpooledFile, options: RegisterOptions) -> Revision:
    name, unpacked = f"scan{extension_of(scan.name)}", None
    if name.lower().endswith(".zip"):
        unpacked = await asyncio.to_thread(unpacked_bytes, scan.path, MAX_COUNTED_BYTES)
    key = await services.registry.adopt_scan(ref, name, scan.path, scan.sha256)
    services.metrics.upload_bytes.inc(scan.num_bytes)
    return Revision(ref.revision, key, scan.name, scan.num_bytes, scan.sha256, options, unpacked)


def _begun(request: Request, record: MapRecord) -> MapRecord:
    if record.newest.status == "queued":
        services_of(request).registrations.begin(record.newest_ref, request.state.request_id)
    return record


def _accepted(record: MapRecord) -> Response:
    headers = {"Location": f"/maps/{record.id}", "Retry-After": str(_RETRY_AFTER_S)}
    return JSONResponse(map_document(record, None), 202, headers)
