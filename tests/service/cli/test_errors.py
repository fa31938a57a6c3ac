"""What a person sees when something is wrong: never a traceback, always what to do."""

from pathlib import Path

import httpx
import pytest

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import default_url
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, problem


def test_a_problem_shows_what_came_what_to_do_and_the_request_id(
    panoloc: Panoloc, fake: FakeService, panorama: Path
) -> None:
    fake.fail_with = problem(409, "Map not ready", "Map map_1 is still indexing; ask again when it is ready.")
    done = panoloc("localize", panorama, "--map", "map_1")
    assert done.code == ExitCode.ERROR
    assert done.out == ""
    for shown in ("Map not ready", "HTTP 409", "still indexing; ask again", "req_7"):
        assert shown in done.err
    assert "Traceback" not in done.err


def test_a_key_that_is_missing_or_unknown_says_where_to_put_one(panoloc: Panoloc, fake: FakeService) -> None:
    fake.fail_with = problem(401, "An API key is needed", "expected an API key, got none")
    assert "Set PANOLOC_API_KEY" in panoloc("maps").err


def test_a_full_queue_says_when_to_try_again(panoloc: Panoloc, fake: FakeService, panorama: Path) -> None:
    fake.fail_with = problem(429, "Queue full", "64 requests wait already.", **{"retry-after": "3"})
    assert "Try again in 3 s." in panoloc("localize", panorama, "--map", "map_1").err


def test_a_problem_in_json_mode_is_a_document_too(panoloc: Panoloc, fake: FakeService) -> None:
    fake.fail_with = problem(404, "Unknown map", "There is no map map_9.")
    done = panoloc("maps", "delete", "map_9", "--json")
    assert done.code == ExitCode.ERROR
    assert done.documents[0]["error"]["status"] == 404
    assert done.documents[0]["error"]["detail"] == "There is no map map_9."


def test_no_service_says_how_to_start_one(panoloc: Panoloc, fake: FakeService) -> None:
    fake.down = True
    done = panoloc("maps")
    assert done.code == ExitCode.UNREACHABLE
    assert "http://127.0.0.1:8000" in done.err
    assert "panoloc serve" in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize(
    "reply",
    [
        httpx.Response(502, text="<html>bad gateway</html>"),
        httpx.Response(200, text="<html>hello</html>"),
        httpx.Response(404, json={"error": "x"}),
    ],
)
def test_an_answer_of_something_else_is_told_from_one_of_the_service(
    panoloc: Panoloc, fake: FakeService, reply: httpx.Response
) -> None:
    fake.fail_with = reply
    done = panoloc("maps")
    assert done.code == ExitCode.ERROR
    assert "panoloc" in done.err
    assert "Traceback" not in done.err


def test_markup_in_a_message_is_shown_as_it_is(panoloc: Panoloc, fake: FakeService) -> None:
    fake.fail_with = problem(422, "Invalid options", "starts.region: expected [min] and [/max], got [1]")
    assert "[min] and [/max], got [1]" in panoloc("maps").err


@pytest.mark.parametrize(
    "url", ["localhost", "localhost:8000", "ftp://127.0.0.1", "http://", "http://127.0.0.1:no", "http://[::1"]
)
def test_a_url_that_is_none_is_explained(panoloc: Panoloc, url: str) -> None:
    done = panoloc("maps", "--url", url)
    assert done.code == ExitCode.ERROR
    assert "--url" in done.err
    assert "Traceback" not in done.err


@pytest.mark.parametrize("key", ["sup3rsecret\r", "sup3rsecret ", "sup3r\nsecret", "schlüssel-secret"])
def test_a_key_that_cannot_be_sent_is_explained_and_not_printed(
    panoloc: Panoloc, fake: FakeService, monkeypatch: pytest.MonkeyPatch, key: str
) -> None:
    monkeypatch.setenv("PANOLOC_API_KEY", key)
    done = panoloc("maps")
    assert (done.code, fake.requests) == (ExitCode.ERROR, [])
    assert "PANOLOC_API_KEY" in done.err
    assert "secret" not in done.err + done.out
    assert "Traceback" not in done.err


def test_the_url_may_come_from_the_environment(
    panoloc: Panoloc, fake: FakeService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_URL", "http://elsewhere:81/")
    panoloc("maps")
    assert fake.requests[0] == ("GET", "http://elsewhere:81/maps")


@pytest.mark.parametrize(
    ("settings", "url"),
    [
        ({}, "http://127.0.0.1:8000"),
        ({"PANOLOC_HOST": "0.0.0.0", "PANOLOC_PORT": "8177"}, "http://127.0.0.1:8177"),
        ({"PANOLOC_HOST": "maps.example"}, "http://maps.example:8000"),
    ],
)
def test_without_a_url_the_service_is_where_one_with_the_same_settings_listens(
    monkeypatch: pytest.MonkeyPatch, settings: dict[str, str], url: str
) -> None:
    for name in ("PANOLOC_HOST", "PANOLOC_PORT"):
        monkeypatch.delenv(name, raising=False)
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    assert default_url() == url


@pytest.mark.parametrize("arguments", [["unknown"], ["maps", "--nonsense"], ["register"], ["localize", "--top-k", "0"]])
def test_wrong_usage_has_its_own_exit_code(panoloc: Panoloc, arguments: list[str]) -> None:
    done = panoloc(*arguments)
    assert done.code == ExitCode.USAGE
    assert done.err
    assert "Traceback" not in done.err
