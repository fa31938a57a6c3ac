"""What a progress bar hears while a file is sent."""

from pathlib import Path

import httpx

from panoloc.service.client import PanolocClient
from tests.service.cli.fake_service import FakeService


def test_progress_rises_to_the_size_of_the_file(fake: FakeService, scan: Path) -> None:
    heard: list[tuple[int, int]] = []
    with PanolocClient("http://127.0.0.1:8000", transport=httpx.MockTransport(fake.handle)) as client:
        client.register_map(scan, progress=lambda sent, size: heard.append((sent, size)))
    sizes = [sent for sent, _ in heard]
    assert sizes == sorted(sizes)
    assert len(set(sizes)) > 2, "a large file is sent in several blocks"
    assert heard[-1] == (scan.stat().st_size, scan.stat().st_size)


def test_the_api_key_travels_as_a_bearer_token(fake: FakeService) -> None:
    seen: list[str] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(request.headers.get("authorization", ""))
        return fake.handle(request)

    with PanolocClient("http://127.0.0.1:8000", api_key="secret", transport=httpx.MockTransport(handle)) as client:
        list(client.list_maps())
    assert seen == ["Bearer secret"]
