"""The page of another site cannot use a browser to reach a service that asks for no key."""

import socket

import pytest

from tests.service.http.running_service import SCAN, RunningService, Serve

pytestmark = pytest.mark.anyio

OWN = [
    "localhost",
    "localhost:8000",
    "127.0.0.1:8000",
    "[::1]:8000",
    "192.168.1.7",
    "a.localhost",
    socket.gethostname(),
]


async def test_a_name_that_was_pointed_here_reaches_nothing(running: RunningService) -> None:
    for host in ("evil.example", "evil.example:8000", "localhost.evil.example", "127.0.0.1.evil.example"):
        for path in ("/maps", "/", "/health"):
            reply = await running.client.get(path, headers={"Host": host})
            assert (reply.status_code, reply.json()["type"]) == (403, "/problems/foreign-page")
        assert "PANOLOC_ALLOWED_HOSTS" in reply.json()["detail"]


async def test_two_names_are_none(running: RunningService) -> None:
    for names in (("127.0.0.1", "evil.example"), ("evil.example", "127.0.0.1"), ("localhost",) * 2):
        reply = await running.client.get("/maps", headers=[("Host", name) for name in names])
        assert (reply.status_code, reply.json()["type"]) == (403, "/problems/foreign-page")


async def test_of_two_origins_both_count(running: RunningService) -> None:
    headers = [("Host", "localhost"), ("Origin", "http://localhost"), ("Origin", "http://evil.example")]
    assert await running.status("DELETE", "/maps/map_none", headers=headers) == 403
    assert await running.status("DELETE", "/maps/map_none", headers=headers[:2]) == 404


async def test_addresses_and_names_of_this_machine_are_served(running: RunningService) -> None:
    for host in OWN:
        assert await running.status("GET", "/maps", headers={"Host": host}) == 200, host


@pytest.mark.parametrize(
    "headers", [{"Origin": "https://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}], ids=str
)
async def test_the_page_of_another_site_changes_nothing(running: RunningService, headers: dict[str, str]) -> None:
    map_id = await running.ready_map()
    upload = {"file": ("office.ply", SCAN)}
    for reply in (
        await running.client.post("/maps", files=upload, headers=headers),
        await running.client.post("/localize", files={"image": b"a"}, headers=headers),
        await running.client.delete(f"/maps/{map_id}", headers=headers),
    ):
        assert (reply.status_code, reply.json()["type"]) == (403, "/problems/foreign-page")
    assert await running.status("GET", f"/maps/{map_id}", headers=headers) == 200


async def test_a_page_of_the_service_itself_may_change_maps(running: RunningService) -> None:
    headers = {"Host": "127.0.0.1:8000", "Origin": "http://127.0.0.1:8000", "Sec-Fetch-Site": "same-origin"}
    reply = await running.client.post("/maps", files={"file": ("office.ply", SCAN)}, headers=headers)
    assert reply.status_code == 202


@pytest.mark.parametrize(
    "changes",
    [{"allowed_hosts": "maps.example, other.example"}, {"allowed_hosts": "*"}, {"api_keys": "the-reader:read"}],
    ids=str,
)
async def test_names_that_the_operator_allows_are_served_and_keys_make_names_harmless(
    serve: Serve, changes: dict[str, str]
) -> None:
    async with serve(**changes) as running:
        headers = {"Host": "Maps.Example:443", "X-API-Key": "the-reader"}
        assert await running.status("GET", "/maps", headers=headers) == 200
