"""Maps over HTTP: from the upload to the deletion."""

import asyncio
import io
import json
import zipfile
from collections.abc import AsyncIterator
from functools import partial

import httpx
import pytest
import redis

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.options import IndexOptions, ScanOptions, Status
from panoloc.service.errors import CacheDownError
from panoloc.service.http.schemas.known_map import Map, MapPage
from panoloc.service.limits.registration_limits import RegistrationLimits
from tests.service.http.fake_pool import IN_UTM, PNG, no_worker, outcome_of, ply_of
from tests.service.http.running_service import SCAN, RunningService

pytestmark = pytest.mark.anyio
OTHER_SCAN = ply_of([(0.0, 0.0, 0.0), (2.0, 2.0, 2.0)])


async def test_an_upload_is_answered_with_the_map_and_where_to_poll(running: RunningService) -> None:
    running.pool.register_gate.clear()
    options = {"name": "3rd floor", "tags": ["a", "a", "b"], "unit": "mm", "starts": {"method": "grid"}}
    reply = await running.upload(options=json.dumps(options))
    body = reply.json()
    assert reply.status_code == 202
    assert reply.headers["location"] == f"/maps/{body['id']}"
    assert int(reply.headers["retry-after"]) >= 1
    assert (body["name"], body["tags"], body["revision"], body["serving_revision"]) == (
        "3rd floor",
        ["a", "b"],
        1,
        None,
    )
    Map.model_validate(body)


async def test_the_worker_gets_the_scan_as_it_came_and_every_option(running: RunningService) -> None:
    await running.ready_map('{"unit": "ft", "starts": {"spacing_m": 0.5}}')
    job = running.pool.registrations[0]
    assert running.storage.read(job.scan_key) == SCAN
    assert job.scan_key.endswith("/1/scan.ply")
    assert job.options.scan == ScanOptions(unit="ft", up_axis="auto", color_kind="rgb")
    assert job.options.index == IndexOptions("octree", 0.5, None, "rgb")


async def test_progress_moves_while_a_worker_is_at_it(running: RunningService) -> None:
    running.pool.register_gate.clear()
    map_id = (await running.upload()).json()["id"]
    body = await running.eventually(f"/maps/{map_id}", lambda body: body["status"] == "indexing")
    assert (body["stage"], body["progress"], body["stats"]) == ("rendering starts", 0.4, None)
    running.pool.register_gate.set()
    body = await running.settled(map_id)
    assert (body["status"], body["progress"], body["serving_revision"]) == ("ready", 1.0, 1)
    assert body["stats"]["num_starts"] == 412
    Map.model_validate(body)


async def test_a_scan_that_cannot_become_a_map_leaves_a_failed_map_with_a_problem(running: RunningService) -> None:
    running.pool.fail_register = [ScanContentError("expected colours, got none; export with colours")]
    body = await running.settled((await running.upload()).json()["id"])
    assert body["status"] == "failed"
    assert body["error"]["type"] == "/problems/scan-unusable"
    assert body["error"]["status"] == 422
    assert "export with colours" in body["error"]["detail"]
    assert body["error"]["request_id"].startswith("req_")


async def test_a_lost_worker_or_cache_only_delays_a_registration(running: RunningService) -> None:
    running.pool.fail_register = [no_worker(), CacheDownError("Redis is away", 0)]
    await running.ready_map()
    assert len(running.pool.registrations) == 3


async def test_a_registration_that_loses_every_worker_fails_in_the_end(running: RunningService) -> None:
    running.pool.fail_register = [no_worker() for _ in range(5)]
    body = await running.settled((await running.upload()).json()["id"])
    assert body["error"]["type"] == "/problems/no-worker"


async def test_a_fault_that_nobody_expected_is_not_told_to_callers(running: RunningService) -> None:
    running.pool.fail_register = [RuntimeError("secret path /root/x")]
    body = await running.settled((await running.upload()).json()["id"])
    assert body["error"]["type"] == "/problems/internal-error"
    assert "secret" not in json.dumps(body)


async def test_pages_list_every_map_once_and_tags_narrow_them(running: RunningService) -> None:
    ids = [await running.ready_map(json.dumps({"tags": ["odd"] if number % 2 else []})) for number in range(5)]
    MapPage.model_validate(await running.json("/maps"))
    assert [item["id"] for item in await running.pages("/maps")] == ids
    tagged = (await running.client.get("/maps", params={"tag": "odd"})).json()["items"]
    assert [item["id"] for item in tagged] == ids[1::2]


async def test_patch_changes_what_is_given_and_nothing_else(running: RunningService) -> None:
    running.pool.bounds = IN_UTM
    map_id = await running.ready_map('{"name": "old", "tags": ["kept"]}')
    place = {"latitude_deg": 52.5, "longitude_deg": 13.4}
    body = (await running.client.patch(f"/maps/{map_id}", json={"name": "new", "georeference": place})).json()
    assert (body["name"], body["tags"]) == ("new", ["kept"])
    assert body["georeference"] == {**place, "height_m": 0.0, "heading_deg": 0.0}
    for field, given, shown in (
        ("georeference", None, None),
        ("coordinate_system", "epsg:25832", "EPSG:25832"),
        ("coordinate_system", None, None),
        ("geoid_undulation_m", 46.2, 46.2),
        ("geoid_undulation_m", None, None),
    ):
        body = (await running.client.patch(f"/maps/{map_id}", json={field: given})).json()
        assert body[field] == shown
    assert body["updated_at"] > body["created_at"]


async def test_patch_names_the_field_that_is_wrong(running: RunningService) -> None:
    map_id = await running.ready_map()
    changes: list[dict[str, object]] = [
        {"name": None}, {"name": ""}, {"tags": None}, {"nmae": "x"}, {"georeference": {"latitude_deg": 91}},
        {"coordinate_system": "EPSG:4326"}, {"coordinate_system": "PROJCS[x"}, {"geoid_undulation_m": 4000},
    ]  # fmt: skip
    for change in changes:
        reply = await running.client.patch(f"/maps/{map_id}", json=change)
        assert reply.status_code == 422
        assert reply.json()["fields"][0]["field"].startswith(next(iter(change)))


async def test_a_new_scan_is_built_while_the_old_one_serves(running: RunningService) -> None:
    map_id = await running.ready_map('{"unit": "cm"}')
    running.pool.register_gate.clear()
    reply = await running.client.put(
        f"/maps/{map_id}/scan", files={"file": ("new.ply", SCAN)}, data={"options": '{"up_axis": "y"}'}
    )
    assert reply.status_code == 202
    body = await running.eventually(f"/maps/{map_id}", lambda body: body["status"] == "indexing")
    assert (body["revision"], body["serving_revision"]) == (2, 1)
    assert body["stats"] is not None
    assert await running.status("GET", f"/maps/{map_id}/preview.png") == 200
    running.pool.register_gate.set()
    body = await running.settled(map_id)
    assert (body["revision"], body["serving_revision"]) == (2, 2)
    assert running.pool.registrations[1].options.scan.unit == "cm"
    assert running.pool.registrations[1].options.scan.up_axis == "y"


async def test_patch_reads_the_stored_scan_again_while_the_old_map_serves(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.register_gate.clear()
    change = {"unit": "ft", "height_unit": "m", "up_axis": "-y", "name": "mended"}
    body = (await running.client.patch(f"/maps/{map_id}", json=change)).json()
    assert (body["revision"], body["serving_revision"], body["status"], body["name"]) == (2, 1, "queued", "mended")
    running.pool.register_gate.set()
    body = await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 2)
    job = running.pool.registrations[-1]
    assert running.storage.read(job.scan_key) == SCAN
    assert (job.options.scan.unit, job.options.scan.height_unit, job.options.scan.up_axis) == ("ft", "m", "-y")
    await running.eventually("/health", lambda body: running.storage.names(f"maps/{map_id}") == ["2", "map.json"])
    # What is so already, and what moves nothing, needs no registration.
    for same in ({"unit": "ft"}, {"geoid_undulation_m": 30.0}):
        assert (await running.client.patch(f"/maps/{map_id}", json=same)).json()["revision"] == 2


@pytest.mark.parametrize(
    ("first", "stated", "revision"),
    [
        ({}, {"unit": "m"}, 1),
        ({}, {"height_unit": "m"}, 1),
        ({}, {"up_axis": "z"}, 1),
        ({}, {"unit": "m", "height_unit": "ft"}, 2),
        ({"unit": "us-ft"}, {"coordinate_system": "EPSG:2230"}, 1),
        ({"unit": "ft"}, {"unit": "auto"}, 2),
        ({"unit": "ft"}, {"unit": "ft"}, 1),
    ],
)
async def test_what_a_scan_is_read_as_already_is_noted_without_reading_it_again(
    running: RunningService, first: dict[str, str], stated: dict[str, str], revision: int
) -> None:
    choices = [{"label": "so", "patch": stated, "storey_height_m": 2.7, "extent_m": [4.0, 3.0, 2.7]}]
    doubt = {
        "code": "unit_doubtful",
        "severity": "warning",
        "message": "High.",
        "question": {"text": "?", "choices": choices},
    }
    in_san_diego = {"min": [1_914_000.0, 560_800.0, 120.0], "max": [1_914_012.0, 560_808.0, 123.0]}
    running.pool.doubts, running.pool.bounds = [doubt], in_san_diego
    map_id = await running.ready_map(json.dumps(first))
    body = (await running.client.patch(f"/maps/{map_id}", json=stated)).json()
    assert body["revision"] == revision
    is_asked = any(each["question"] for each in body["diagnostics"] if each["code"] == "unit_doubtful")
    assert is_asked == (revision == 2 or "coordinate_system" in stated)
    if "unit" in stated and revision == 1:
        await running.client.put(f"/maps/{map_id}/scan", files={"file": ("new.ply", SCAN)})
        await running.settled(map_id)
        assert running.pool.registrations[-1].options.scan.unit == stated["unit"]


@pytest.mark.parametrize(("system", "revision"), [("EPSG:25832", 1), ("EPSG:2230", 2), ("EPSG:25832+6360", 2)])
async def test_a_coordinate_system_with_other_units_reads_the_scan_again(
    running: RunningService, system: str, revision: int
) -> None:
    running.pool.bounds = IN_UTM
    map_id = await running.ready_map()
    body = (await running.client.patch(f"/maps/{map_id}", json={"coordinate_system": system})).json()
    assert body["revision"] == revision
    if revision == 2:
        await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 2)
        assert running.pool.registrations[-1].options.scan.coordinate_system == body["coordinate_system"]


async def test_a_coordinate_system_that_the_scan_cannot_be_in_is_refused(running: RunningService) -> None:
    map_id = await running.ready_map()
    reply = await running.client.patch(f"/maps/{map_id}", json={"coordinate_system": "EPSG:25832"})
    assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, "coordinate_system")
    assert "at 6 m east and 4 m north, lies outside its area" in reply.json()["detail"]
    assert (await running.json(f"/maps/{map_id}"))["coordinate_system"] is None


@pytest.mark.parametrize("status", ["localized", "not_localized"])
async def test_every_answer_of_a_map_that_is_in_doubt_says_so(running: RunningService, status: Status) -> None:
    running.pool.outcome_of = partial(outcome_of, status=status)
    choice = {"label": "all in feet", "patch": {"unit": "ft"}, "storey_height_m": 2.7, "extent_m": [4.0, 3.0, 2.7]}
    question = {"text": "Which unit?", "choices": [choice]}
    doubt = {"code": "unit_doubtful", "severity": "warning", "message": "8.86 m high.", "question": question}
    running.pool.doubts = [doubt]
    map_id = await running.ready_map()
    body = await running.json(f"/maps/{map_id}")
    assert Map.model_validate(body).diagnostics[-1].model_dump() == doubt
    answer = (await running.localize(map_id)).json()
    assert answer["reasons"][-1] == "map_doubtful"
    assert "8.86 m high." in answer["warnings"][-1]


async def test_the_replaced_revision_leaves_storage_and_cache(
    running: RunningService, redis_client: "redis.Redis"
) -> None:
    map_id = await running.ready_map()
    await running.replace_scan(map_id)
    await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 2)
    await running.eventually("/health", lambda body: not redis_client.keys(f"index:{map_id}:1:*"))
    assert running.storage.names(f"maps/{map_id}") == ["2", "map.json"]
    assert redis_client.keys(f"index:{map_id}:2:*")


async def test_of_two_new_scans_at_the_same_time_one_stays(running: RunningService) -> None:
    map_id = await running.ready_map()
    put = running.client.put
    replies = await asyncio.gather(
        *(put(f"/maps/{map_id}/scan", files={"file": (name, SCAN)}) for name in ("a.ply", "b.ply", "c.ply"))
    )
    assert [reply.status_code for reply in replies] == [202, 202, 202]
    body = await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 4)
    assert (body["revision"], body["status"]) == (4, "ready")
    await running.eventually("/health", lambda body: running.storage.names(f"maps/{map_id}") == ["4", "map.json"])


async def test_a_map_deleted_while_a_new_scan_comes_in_stays_deleted(running: RunningService) -> None:
    map_id = await running.ready_map()
    request = httpx.Request("PUT", "http://panoloc", files={"file": ("a.ply", SCAN)})
    body = request.read()

    async def interrupted() -> AsyncIterator[bytes]:
        yield body[:50]
        assert await running.status("DELETE", f"/maps/{map_id}") == 204
        yield body[50:]

    headers = {"content-type": request.headers["content-type"]}
    reply = await running.client.put(f"/maps/{map_id}/scan", headers=headers, content=interrupted())
    assert reply.status_code == 404
    assert running.storage.names("maps") == []
    assert running.storage.names("uploads") == []


async def test_a_new_scan_that_fails_leaves_the_old_one_serving(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.fail_register = [ScanDamagedError("cut off")]
    await running.replace_scan(map_id)
    body = await running.settled(map_id)
    assert (body["status"], body["serving_revision"], body["revision"]) == ("failed", 1, 2)
    assert (await running.localize(map_id)).status_code == 200


@pytest.mark.parametrize(
    ("error", "read"), [(ScanDamagedError("cut off"), SCAN), (ScanContentError("900 km high: in mm?"), OTHER_SCAN)]
)
async def test_patch_after_a_failed_revision_reads_its_scan_again_or_the_serving_one_where_it_is_damaged(
    running: RunningService, error: Exception, read: bytes
) -> None:
    map_id = await running.ready_map('{"unit": "cm"}')
    running.pool.fail_register = [error]
    await running.client.put(f"/maps/{map_id}/scan", files={"file": ("new.ply", OTHER_SCAN)})
    assert (await running.settled(map_id))["status"] == "failed"
    # What the serving scan is read as already brings back no registration of a damaged one.
    assert (await running.client.patch(f"/maps/{map_id}", json={"unit": "cm"})).json()["revision"] == 2
    assert (await running.client.patch(f"/maps/{map_id}", json={"unit": "m"})).json()["revision"] == 3
    await running.eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == 3)
    job = running.pool.registrations[-1]
    assert running.storage.read(job.scan_key) == read
    assert job.options.scan.unit == "m"


@pytest.mark.parametrize(("scan", "status"), [(b"ply", 415), (SCAN[:-1], 422)])
async def test_a_new_scan_is_checked_as_a_first_one(running: RunningService, scan: bytes, status: int) -> None:
    map_id = await running.ready_map()
    assert (await running.upload(scan, "a.ply")).status_code == status
    assert await running.status("PUT", f"/maps/{map_id}/scan", files={"file": ("a.ply", scan)}) == status


async def test_deleting_a_map_leaves_nothing_of_it(running: RunningService, redis_client: "redis.Redis") -> None:
    map_id = await running.ready_map()
    answer = (await running.localize(map_id, options='{"artifacts": ["overlay"]}')).json()
    assert redis_client.keys("index:*")
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    assert redis_client.keys("*") == []
    assert not (running.data_dir / "maps" / map_id).exists()
    for path in (f"/maps/{map_id}", answer["artifacts"]["overlay"], f"/localizations/{answer['id']}"):
        assert await running.status("GET", path) == 404
    assert await running.status("DELETE", f"/maps/{map_id}") == 404


async def test_deleting_a_map_ends_its_registration(running: RunningService) -> None:
    running.pool.register_gate.clear()
    map_id = (await running.upload()).json()["id"]
    await running.eventually(f"/maps/{map_id}", lambda body: body["status"] == "indexing")
    assert await running.status("DELETE", f"/maps/{map_id}") == 204
    assert running.pool.ended == ["register"]


async def test_viewers_get_a_picture_points_and_starts(running: RunningService) -> None:
    map_id = await running.ready_map()
    preview = await running.client.get(f"/maps/{map_id}/preview.png")
    assert (preview.content, preview.headers["content-type"]) == (PNG, "image/png")
    starts = await running.json(f"/maps/{map_id}/starts")
    assert starts["starts"] == [{"position_m": [1.0, 2.0, 1.5], "leaf_size_m": 0.5}]
    assert starts["num_starts"] == 1


async def test_points_come_as_ply_unless_json_is_asked_for(running: RunningService) -> None:
    path = f"/maps/{await running.ready_map()}/points"
    ply = await running.client.get(path, params={"max_points": 3})
    assert ply.headers["content-type"] == "application/ply"
    header, _, body = ply.content.partition(b"end_header\n")
    assert b"element vertex 3\n" in header
    assert len(body) == 3 * 15
    for headers, params in (({"accept": "application/json"}, {}), ({}, {"format": "json"})):
        found = (await running.client.get(path, headers=headers, params=params)).json()
        assert found["num_points"] == 10
        assert found["positions_m"][2] == [2.0, 0.0, 1.0]
        assert found["colors"][2] == [128, 128, 128]


@pytest.mark.parametrize("name", ["preview.png", "points", "starts"])
async def test_what_viewers_show_is_not_there_before_the_map_is_ready(running: RunningService, name: str) -> None:
    running.pool.register_gate.clear()
    map_id = (await running.upload()).json()["id"]
    reply = await running.client.get(f"/maps/{map_id}/{name}")
    assert reply.status_code == 409
    assert int(reply.headers["retry-after"]) >= 1
    assert await running.status("GET", f"/maps/map_none/{name}") == 404


async def test_the_limit_of_maps_is_said_before_the_upload_is_read(running: RunningService) -> None:
    registry = running.app.state.services.registry
    registry._max_maps = 1
    await running.ready_map()
    reply = await running.upload()
    assert reply.status_code == 409
    assert "PANOLOC_MAX_MAPS" in reply.json()["detail"]


async def test_the_time_of_a_registration_follows_what_an_archive_unpacks_to(running: RunningService) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("table.xyz", bytes(50_000_000))
    map_id = (await running.upload(packed.getvalue(), "scan.zip")).json()["id"]
    await running.settled(map_id)
    assert [job.time_limit_s for job in running.pool.registrations] == [RegistrationLimits().seconds(50_000_000)]


async def test_a_position_of_a_map_is_told_on_its_grid_and_on_earth(running: RunningService) -> None:
    map_id = await running.ready_map()
    at = {"x": 691000.0, "y": 5334000.0, "z": 520.0}
    nowhere = (await running.client.get(f"/maps/{map_id}/coordinates", params=at)).json()
    assert nowhere == {"position_m": [691000.0, 5334000.0, 520.0], "grid": None, "wgs84": None}
    await running.client.patch(f"/maps/{map_id}", json={"coordinate_system": "EPSG:2230"})
    # A grid in US survey feet; the map's positions are in metres.
    in_feet = (await running.client.get(f"/maps/{map_id}/coordinates", params={"x": 1.9e6, "y": 6e5, "z": 20})).json()
    assert in_feet["grid"]["unit"] == "ftUS"
    assert in_feet["grid"]["east"] == pytest.approx(1.9e6 * 3937 / 1200, abs=0.001)
    place = {"latitude_deg": 48.0, "longitude_deg": 11.0, "height_m": 500.0, "heading_deg": 90.0}
    await running.client.patch(f"/maps/{map_id}", json={"coordinate_system": None, "georeference": place})
    # The y axis points east, so x points south: 111.3 m are 0.001 degrees.
    found = (await running.client.get(f"/maps/{map_id}/coordinates", params={"x": -111.2, "y": 0, "z": 2})).json()
    assert found["wgs84"]["latitude_deg"] == pytest.approx(48.001, abs=2e-6)
    assert found["wgs84"]["longitude_deg"] == pytest.approx(11.0, abs=1e-7)
    assert found["wgs84"]["height_m"] == pytest.approx(502.0, abs=0.002)
    # As in answers and exports, it takes precedence over a coordinate system.
    await running.client.patch(f"/maps/{map_id}", json={"coordinate_system": "EPSG:25832"})
    again = (await running.client.get(f"/maps/{map_id}/coordinates", params={"x": -111.2, "y": 0, "z": 2})).json()
    assert again == found
    assert again["grid"] is None
    assert await running.status("GET", f"/maps/{map_id}/coordinates?x=1&y=2") == 422
    no_number = (await running.client.get(f"/maps/{map_id}/coordinates", params={"x": "nan", "y": 0, "z": 2})).json()
    assert no_number["fields"] == [{"field": "x", "message": "expected a finite number, got 'nan'"}]
