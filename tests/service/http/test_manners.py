"""What clients expect of any API: nothing is sent twice or done twice, text is compressed, pages of allowed origins may ask."""

import gzip
from collections.abc import AsyncIterator

import httpx
import pytest

from panoloc.service.http import responses
from tests.service.http.fake_pool import no_worker
from tests.service.http.running_service import SCAN, RunningService, Serve, png_of

pytestmark = pytest.mark.anyio

PAGE = "https://app.example.org"
ONCE = {"Idempotency-Key": "3f1c-7"}


@pytest.mark.parametrize("path", ["", "/preview.png", "/points", "/starts"])
async def test_what_the_caller_has_is_not_sent_again(running: RunningService, path: str) -> None:
    map_id = await running.ready_map()
    first = await running.client.get(f"/maps/{map_id}{path}")
    tag = first.headers["ETag"]
    for known in (tag, tag.removeprefix("W/"), f"W/{tag.removeprefix('W/')}", f'"other", {tag}', "*"):
        again = await running.client.get(f"/maps/{map_id}{path}", headers={"If-None-Match": known})
        assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", tag)
        assert "content-length" not in again.headers
    other = await running.client.get(f"/maps/{map_id}{path}", headers={"If-None-Match": '"other"'})
    assert (other.status_code, other.content) == (200, first.content)


@pytest.mark.parametrize(
    ("path", "field", "said"),
    [
        ("/maps?tagg=office", "tagg", "perhaps you mean tag"),
        ("/maps/{}/points?maxpoints=10", "maxpoints", "perhaps you mean max_points"),
        ("/maps/{}?frame=webxr", "frame", "the path takes none"),
        ("/batches?a=1&limit=5", "a", "the path takes limit, cursor"),
    ],
)
async def test_a_query_parameter_that_nothing_reads_is_refused(
    running: RunningService, path: str, field: str, said: str
) -> None:
    map_id = await running.ready_map()
    refused = await running.client.get(path.format(map_id))
    assert refused.status_code == 422
    assert refused.json()["fields"][0]["field"] == field
    assert said in refused.json()["detail"]
    assert (await running.client.get("/health/live?probe=1")).status_code == 200


async def test_a_changed_map_is_sent_again(running: RunningService) -> None:
    map_id = await running.ready_map()
    tag = (await running.client.get(f"/maps/{map_id}")).headers["ETag"]
    await running.client.patch(f"/maps/{map_id}", json={"name": "another"})
    again = await running.client.get(f"/maps/{map_id}", headers={"If-None-Match": tag})
    assert (again.status_code, again.json()["name"]) == (200, "another")


async def test_text_is_compressed_for_who_accepts_it_and_files_are_not(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(responses, "_LEAST_BYTES", 1)
    async with serve() as running:
        map_id = await running.ready_map()
        for path, is_text in (("/openapi.json", True), (f"/maps/{map_id}", True), (f"/maps/{map_id}/points", False)):
            plain = await running.client.get(path, headers={"Accept-Encoding": "identity"})
            async with running.client.stream("GET", path, headers={"Accept-Encoding": "gzip"}) as reply:
                sent = b"".join([part async for part in reply.aiter_raw()])
            assert [each.headers.get("content-encoding") for each in (plain, reply)] == [
                None,
                "gzip" if is_text else None,
            ]
            assert (gzip.decompress(sent) if is_text else sent) == plain.content


@pytest.mark.settings(allowed_origins=f"{PAGE}:443/, http://localhost:5173")
async def test_pages_of_allowed_origins_may_call_from_browsers(running: RunningService) -> None:
    map_id = await running.ready_map()
    wanted = {"Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization,content-type"}
    asked = await running.client.options("/localize", headers={"Origin": PAGE, **wanted})
    assert (asked.status_code, asked.headers["Access-Control-Allow-Origin"]) == (200, PAGE)
    assert "authorization" in asked.headers["Access-Control-Allow-Headers"]
    reply = await running.localize(map_id, headers={"Origin": PAGE, "Sec-Fetch-Site": "cross-site"})
    assert (reply.status_code, reply.headers["Access-Control-Allow-Origin"]) == (200, PAGE)
    assert {"Retry-After", "Content-Location"} <= set(reply.headers["Access-Control-Expose-Headers"].split(", "))
    lost = await running.client.get("/maps/map_none", headers={"Origin": PAGE})  # a page can read why
    assert (lost.status_code, lost.headers["Access-Control-Allow-Origin"]) == (404, PAGE)
    other = await running.localize(map_id, headers={"Origin": "https://evil.example"})
    assert (other.status_code, "Access-Control-Allow-Origin" in other.headers) == (403, False)
    wanted["Access-Control-Request-Private-Network"] = "true"
    assert (await running.client.options("/localize", headers={"Origin": PAGE, **wanted})).status_code == 200
    both = [("Origin", PAGE), ("Origin", "https://evil.example")]
    assert await running.status("DELETE", f"/maps/{map_id}", headers=both) == 403


async def test_without_allowed_origins_no_page_of_another_one_may(running: RunningService) -> None:
    map_id = await running.ready_map()
    reply = await running.localize(map_id, headers={"Origin": PAGE})
    assert (reply.status_code, "Access-Control-Allow-Origin" in reply.headers) == (403, False)
    assert "PANOLOC_ALLOWED_ORIGINS" in reply.json()["detail"]


@pytest.mark.parametrize("text", ["app.example.org", "https://app.example.org/page", "https://*.example.org"])
async def test_what_is_no_origin_is_refused_at_the_start(serve: Serve, text: str) -> None:
    with pytest.raises(ValueError, match=r"expected origins such as https://app\.example\.org"):
        async with serve(allowed_origins=text):
            raise AssertionError("it starts")


async def test_a_query_can_be_cancelled_and_an_answer_deleted(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.localize_gate.clear()
    later = await running.localize(map_id, headers={"Prefer": "respond-async"})
    path = later.headers["Location"]
    assert await running.status("DELETE", path) == 204
    assert running.pool.ended == ["localize"]
    assert await running.status("GET", path) == 404
    running.pool.localize_gate.set()
    done = (await running.localize(map_id, options='{"artifacts": ["overlay"]}')).json()
    path, picture = f"/localizations/{done['id']}", done["artifacts"]["overlay"]
    assert await running.status("GET", picture) == 200
    assert await running.status("DELETE", path) == 204
    assert [await running.status("GET", each) for each in (path, picture)] == [404, 404]
    assert await running.status("DELETE", path) == 404


async def test_a_request_that_is_sent_again_is_not_done_again(running: RunningService) -> None:
    first, again = [await running.client.post("/maps", files={"file": ("a.ply", SCAN)}, headers=ONCE) for _ in "12"]
    assert (first.status_code, again.status_code) == (202, 202)
    assert again.content == first.content
    assert again.headers["Location"] == first.headers["Location"]
    assert (first.headers.get("Idempotent-Replayed"), again.headers["Idempotent-Replayed"]) == (None, "true")
    assert len((await running.json("/maps"))["items"]) == 1
    map_id = (await running.settled(first.json()["id"]))["id"]
    # The key counts for one path.
    queries = [await running.localize(map_id, headers=ONCE) for _ in "12"]
    assert queries[0].json() == queries[1].json()
    assert len(running.pool.jobs) == 1
    assert (await running.localize(map_id, headers={"Idempotency-Key": "a b"})).status_code == 400


async def test_the_key_of_another_request_is_refused_however_alike_that_is(running: RunningService) -> None:
    map_id = await running.ready_map()
    assert (await running.localize(map_id, options='{"frame": "webxr"}', headers=ONCE)).status_code == 200
    for request in (
        {"options": '{"frame": "unity"}', "headers": ONCE},  # of the same length
        {"options": '{"frame": "webxr"}', "headers": ONCE, "image": png_of(16, 8)},
        {"options": '{"frame": "webxr"}', "headers": {**ONCE, "Prefer": "respond-async"}},
    ):
        other = await running.localize(map_id, **request)
        assert (other.status_code, other.json()["type"]) == (422, "/problems/idempotency-key-reused")
    assert len(running.pool.jobs) == 1


@pytest.mark.parametrize("boundaries", [("a-b", "another-boundary"), ("--0--0", "0")])
async def test_the_boundary_between_parts_is_another_each_time(
    running: RunningService, boundaries: tuple[str, str]
) -> None:
    replies = []
    for boundary, size in zip(boundaries, (7, 1000), strict=True):
        text = f'--{boundary}\r\nContent-Disposition: form-data; name="file"; filename="a.ply"\r\n\r\n'
        body = text.encode() + SCAN + f"\r\n--{boundary}--\r\n".encode()
        parts = [body[at : at + size] for at in range(0, len(body), size)]
        headers = {**ONCE, "Content-Type": f"multipart/form-data; boundary={boundary}"}
        replies.append(await running.client.post("/maps", content=sent_in(parts), headers=headers))
    assert [each.status_code for each in replies] == [202, 202]
    assert replies[0].json()["id"] == replies[1].json()["id"]


async def sent_in(parts: list[bytes]) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


async def test_what_has_failed_since_or_is_deleted_is_done_again(running: RunningService) -> None:
    map_id = await running.ready_map()
    later = {**ONCE, "Prefer": "respond-async"}
    running.pool.fail_localize = [no_worker()]
    running.pool.localize_gate.clear()
    first = (await running.localize(map_id, headers=later)).json()["id"]
    running.pool.localize_gate.set()
    await running.eventually(f"/localizations/{first}", lambda body: body["status"] == "failed")
    second = (await running.localize(map_id, headers=later)).json()["id"]
    assert second != first
    await running.client.delete(f"/localizations/{second}")
    third = (await running.localize(map_id, headers=later)).json()["id"]
    assert (await running.localize(map_id, headers=later)).json()["id"] == third != second
    at_once = {"Idempotency-Key": "at-once"}
    told = [await running.localize(map_id, headers=at_once) for _ in range(2)]
    assert told[0].content == told[1].content
    assert (await running.client.delete(told[0].headers["Content-Location"])).status_code == 204
    assert (await running.localize(map_id, headers=at_once)).json()["id"] != told[0].json()["id"]
    for path, files in (("/maps", {"file": ("a.ply", SCAN)}), ("/batches", {"image": ("a.png", png_of(8, 4))})):
        places = []
        for _ in range(3):
            form = {"map_id": map_id} if path == "/batches" else {}
            reply = await running.client.post(path, files=files, data=form, headers=ONCE)
            places.append(reply.headers["Location"])
            if len(places) == 2:
                assert (await running.client.delete(places[0])).status_code == 204
        assert places[0] == places[1] != places[2]


async def test_a_request_that_failed_is_done_again_and_one_under_way_is_said_to_be(running: RunningService) -> None:
    map_id = await running.ready_map()
    running.pool.fail_localize = [no_worker()]
    assert [(await running.localize(map_id, headers=ONCE)).status_code for _ in "12"] == [503, 200]
    asking = await running.held_query(map_id, headers={"Idempotency-Key": "slow"})
    meanwhile = await running.localize(map_id, headers={"Idempotency-Key": "slow"})
    assert (meanwhile.status_code, meanwhile.json()["type"]) == (409, "/problems/request-under-way")
    assert meanwhile.headers["Retry-After"]
    running.pool.localize_gate.set()
    assert (await asking).status_code == 200


@pytest.mark.settings(max_requests_per_minute=2)
async def test_callers_are_told_how_many_requests_are_left(running: RunningService) -> None:
    replies: list[httpx.Response] = [await running.client.get("/maps") for _ in range(3)]
    assert [each.status_code for each in replies] == [200, 200, 429]
    assert [each.headers["RateLimit-Policy"] for each in replies] == ['"requests";q=2;w=60'] * 3
    left = [int(each.headers["RateLimit"].split(";r=")[1].split(";")[0]) for each in replies]
    assert left == [1, 0, 0]
