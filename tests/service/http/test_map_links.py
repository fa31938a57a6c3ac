"""Links that open a map on phones: with a key for that map alone where the service asks for keys."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from panoloc.service.keys.key_file import KeyFile
from tests.service.http.running_service import RunningService, Serve

pytestmark = pytest.mark.anyio

REQUEST = {"service_url": "https://scanner.local:8000/panoloc/"}


async def test_a_link_of_a_service_without_keys_has_none(running: RunningService) -> None:
    map_id = await running.ready_map()
    reply = await running.client.post(f"/maps/{map_id}/links", json=REQUEST)
    assert (reply.status_code, reply.headers["cache-control"]) == (200, "no-store")
    link = reply.json()
    assert link["url"] == f"https://scanner.local:8000/panoloc/m/{map_id}"
    assert link["key_id"] is None
    assert ElementTree.fromstring(link["qr_svg"]).tag == "{http://www.w3.org/2000/svg}svg"
    assert not (running.data_dir / "keys.json").exists()


@pytest.mark.parametrize(
    "url", ["scanner.local", "javascript:alert(1)", "", None, "https://a/?q=1", "https://a/#b", "https://u:p@a"]
)
async def test_an_address_that_no_phone_opens_is_refused(running: RunningService, url: str | None) -> None:
    map_id = await running.ready_map()
    reply = await running.client.post(f"/maps/{map_id}/links", json={"service_url": url})
    assert (reply.status_code, reply.json()["fields"][0]["field"]) == (422, "service_url")


async def test_the_key_of_a_link_localizes_in_that_map_and_does_nothing_else(tmp_path: Path, serve: Serve) -> None:
    owner_key = KeyFile(tmp_path).make("museum", ["read", "localize", "write"], tenant="museum")[1]
    async with serve() as running:
        museum = running.by(owner_key)
        map_id, other = await museum.ready_map(), await museum.ready_map()
        await museum.client.patch(f"/maps/{map_id}", json={"shared_with": ["school"]})
        links = [(await museum.client.post(f"/maps/{map_id}/links", json=REQUEST)).json() for _ in range(2)]
        address, _, key = links[1]["url"].partition("#key=")
        assert address.endswith(f"/m/{map_id}")
        # Whoever else sees the map is another question, whose answer ends no link.
        assert (await museum.json(f"/maps/{map_id}"))["shared_with"] == ["school"]
        await museum.client.patch(f"/maps/{map_id}", json={"shared_with": []})
        visitor = running.by(key)
        assert [each["id"] for each in (await visitor.json("/maps"))["items"]] == [map_id]
        assert (await visitor.localize(map_id)).status_code == 200
        assert (await visitor.localize(other)).status_code == 404
        assert await visitor.status("PATCH", f"/maps/{map_id}", json={"name": "mine"}) == 403
        assert await visitor.status("DELETE", f"/maps/{map_id}") == 403
        assert await visitor.status("POST", f"/maps/{map_id}/links", json=REQUEST) == 403
        assert await museum.status("POST", "/maps/map_never/links", json=REQUEST) == 404
        await museum.client.delete(f"/maps/{map_id}")
        assert all(stored.revoked_at for stored in KeyFile(tmp_path).read() if stored.tenant == f"visitors-{map_id}")
        lines = [json.loads(line) for line in (running.data_dir / "audit.jsonl").read_text().splitlines()]
        assert [line["what"] for line in lines if line["change"] == "key made"] == [each["key_id"] for each in links]
