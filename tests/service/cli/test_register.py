"""`panoloc register` against a fake service."""

import json
from pathlib import Path

import httpx
import pytest

from panoloc.service.cli import progress
from panoloc.service.client import JsonClient, MapFailedError
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import READY_MAP, FakeService, problem


def test_the_scan_arrives_unchanged_with_its_options(panoloc: Panoloc, fake: FakeService, scan: Path) -> None:
    done = panoloc(
        *("register", scan, "--name", "3rd floor", "--tag", "a", "--tag", "b", "--unit", "mm", "--up-axis", "y"),
        *("--coordinate-system", "EPSG:25832", "--geoid-undulation", "-12.5"),
    )
    assert done.code == 0, done.err
    assert fake.parts["file"] == [scan.read_bytes()]
    assert json.loads(fake.parts["options"][0]) == {
        "name": "3rd floor",
        "tags": ["a", "b"],
        "unit": "mm",
        "up_axis": "y",
        "color_kind": "rgb",
        "coordinate_system": "EPSG:25832",
        "geoid_undulation_m": -12.5,
    }


def test_the_name_defaults_to_that_of_the_file(panoloc: Panoloc, fake: FakeService, scan: Path) -> None:
    panoloc("register", scan)
    assert json.loads(fake.parts["options"][0])["name"] == "office"


def test_waiting_follows_the_registration_until_it_is_ready(panoloc: Panoloc, fake: FakeService, scan: Path) -> None:
    fake.polls = [{**READY_MAP, "status": "reading", "progress": 0.1}, {**READY_MAP, "status": "indexing"}]
    done = panoloc("register", scan)
    assert fake.requests == [("POST", "/maps")] + [("GET", "/maps/map_1")] * 3
    assert "map_1" in done.out
    assert "1,000,000" in done.out
    assert "1,000,000 points were thinned to 250,000." in done.out


def test_without_waiting_nothing_is_polled(panoloc: Panoloc, fake: FakeService, scan: Path) -> None:
    done = panoloc("register", scan, "--no-wait", "--json")
    assert fake.requests == [("POST", "/maps")]
    assert done.documents[0]["status"] == "queued"


def test_names_are_shown_as_they_are(panoloc: Panoloc, fake: FakeService, scan: Path) -> None:
    fake.polls = [{**READY_MAP, "name": "hall :x: [bold]b[/bold] :smile:"}]
    assert "hall :x: [bold]b[/bold] :smile:" in panoloc("register", scan).out


def test_a_failed_map_is_an_error_that_says_why(panoloc: Panoloc, fake: FakeService, scan: Path) -> None:
    reason = "scan: expected 100 vertices, got 40; export it again"
    fake.polls = [{**READY_MAP, "status": "failed", "serving_revision": None, "error": {"detail": reason}}]
    done = panoloc("register", scan)
    assert done.code == 1
    assert reason in done.err
    assert "panoloc maps delete map_1" in done.err
    assert done.out == ""


def test_who_waits_for_a_new_revision_hears_that_the_old_one_still_answers(fake: FakeService) -> None:
    fake.polls = [{**READY_MAP, "status": "failed", "revision": 2, "error": {"detail": "scan: expected 100 vertices"}}]
    with (
        JsonClient("http://127.0.0.1:8000", transport=httpx.MockTransport(fake.handle)) as client,
        pytest.raises(MapFailedError, match="map_1 failed, revision 1 still answers: ") as failed,
    ):
        client.wait_for_map("map_1")
    assert failed.value.serving_revision == 1


def test_a_short_outage_while_waiting_is_sat_out(
    panoloc: Panoloc, fake: FakeService, scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.service.client.client.POLL_LONGEST_S", 0.0)
    outage = [problem(503, "No cache", "Redis is away", **{"retry-after": "0"})]
    fake.on_request = lambda request: outage.pop() if request.method == "GET" and outage else None
    assert panoloc("register", scan).code == 0
    assert outage == []


def test_a_missing_file_is_wrong_usage(panoloc: Panoloc, tmp_path: Path) -> None:
    done = panoloc("register", tmp_path / "nothing.ply")
    assert done.code == 2
    assert "does not exist" in done.err


@pytest.mark.parametrize(
    ("end", "code", "said"),
    [
        (KeyboardInterrupt(), 130, ["map_1: its registration continues", "panoloc maps delete map_1"]),
        (httpx.ConnectError("refused"), 5, ["map_1: its registration continues when the service runs again"]),
        # A key that may upload and not read: nothing went wrong.
        (problem(403, "Not allowed", "expected a key with the scope 'read'"), 0, ["its registration continues"]),
    ],
    ids=["ctrl-c", "service gone", "may not read"],
)
def test_whatever_ends_the_waiting_says_what_becomes_of_the_map(
    panoloc: Panoloc, fake: FakeService, scan: Path, end: BaseException | httpx.Response, code: int, said: list[str]
) -> None:
    fake.at_maps = {"map_1": end}
    done = panoloc("register", scan)
    assert done.code == code
    for words in said:
        assert words in done.said


def test_whoever_gives_up_waiting_knows_the_id_of_what_goes_on(panoloc: Panoloc, scan: Path) -> None:
    done = panoloc("register", scan)
    assert f"Map {READY_MAP['id']}: the scan is stored" in done.err


def test_a_log_is_told_now_and_then_what_a_registration_waits_for(
    panoloc: Panoloc, fake: FakeService, scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake.polls = [{**READY_MAP, "status": "indexing", "stage": "waiting for room on the disk"}, READY_MAP]
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    assert "map_1: indexing waiting for room on the disk" in panoloc("register", scan).err.splitlines()


def test_progress_rises_to_the_size_of_the_file(fake: FakeService, scan: Path) -> None:
    heard: list[tuple[int, int]] = []
    with JsonClient("http://127.0.0.1:8000", transport=httpx.MockTransport(fake.handle)) as client:
        client.register_map(scan, progress=lambda sent, size: heard.append((sent, size)))
    sizes = [sent for sent, _ in heard]
    assert sizes == sorted(sizes)
    assert len(set(sizes)) > 2, "a large file is sent in several blocks"
    assert heard[-1] == (scan.stat().st_size, scan.stat().st_size)


def test_the_api_key_travels_as_a_bearer_token(fake: FakeService) -> None:
    seen: list[str] = []
    fake.on_request = lambda request: seen.append(request.headers["authorization"])
    with JsonClient("http://127.0.0.1:8000", "secret", httpx.MockTransport(fake.handle)) as client:
        list(client.list_maps())
    assert seen == ["Bearer secret"]
