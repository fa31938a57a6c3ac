"""HEAD: what GET answers, without its body."""

import httpx
import pytest

from tests.service.http.running_service import Listen, RunningService

pytestmark = pytest.mark.anyio


@pytest.mark.slow
async def test_what_can_be_read_has_a_head(running: RunningService) -> None:
    map_id = await running.ready_map()
    for path in ("/", "/maps", f"/maps/{map_id}", f"/maps/{map_id}/preview.png", "/health/ready", "/metrics", "/docs"):
        whole, head = await running.client.get(path), await running.client.head(path)
        assert (head.status_code, head.content) == (whole.status_code, b"")
        assert head.headers["content-type"] == whole.headers["content-type"]
        assert whole.status_code == 200
    assert (await running.client.head("/maps/map_none")).status_code == 404


async def test_what_only_takes_uploads_has_none(running: RunningService) -> None:
    refused = await running.client.head("/localize")
    assert (refused.status_code, refused.headers["allow"], refused.content) == (405, "POST", b"")


def test_over_a_socket_the_connection_goes_on_after_a_head(listen: Listen) -> None:
    with listen() as url, httpx.Client(base_url=url, timeout=60) as client:
        for _ in range(2):
            head = client.head("/health")
            assert head.status_code == 200
            assert int(head.headers["content-length"]) > 10
            assert client.get("/health/live").status_code == 200
