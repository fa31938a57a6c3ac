"""What a person sees when something is wrong: never a traceback, always what to do."""

import httpx
import pytest

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import default_url
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, problem


@pytest.mark.parametrize(
    ("reply", "shown"),
    [
        (problem(409, "Map not ready", "ask again later."), ["Map not ready", "HTTP 409", "ask again later.", "req_7"]),
        (problem(401, "An API key is needed", "expected an API key, got none"), ["Set PANOLOC_API_KEY"]),
        (problem(429, "Queue full", "64 requests wait already.", **{"retry-after": "3"}), ["Try again in 3 s."]),
        # Markup is shown as it is.
        (problem(422, "Invalid options", "region: expected [min] and [/max], got [1]"), ["[min] and [/max], got [1]"]),
        # Not of panoloc.
        (httpx.Response(502, text="<html>bad gateway</html>"), ["Expected an answer of panoloc", "HTTP 502"]),
        (
            httpx.Response(200, text="<html>hello</html>"),
            ["Expected a JSON object", "check that panoloc answers there"],
        ),
        (httpx.Response(404, json={"error": "x"}), ["Expected an answer of panoloc", "HTTP 404"]),
    ],
)
def test_a_refusal_shows_what_came_and_what_to_do(
    panoloc: Panoloc, fake: FakeService, reply: httpx.Response, shown: list[str]
) -> None:
    fake.fail_with = reply
    done = panoloc("maps")
    assert (done.code, done.out) == (ExitCode.ERROR, "")
    assert [words for words in shown if words not in done.err] == []
    assert "Traceback" not in done.err


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
    ("name", "value"),
    [
        *(
            ("PANOLOC_URL", url)
            for url in (
                "localhost",
                "localhost:8000",
                "ftp://127.0.0.1",
                "http://",
                "http://127.0.0.1:no",
                "http://[::1",
            )
        ),
        *(("PANOLOC_API_KEY", key) for key in ("sup3rsecret\r", "sup3rsecret ", "sup3r\nsecret", "schlüssel-secret")),
    ],
)
def test_a_url_or_key_that_is_none_is_explained_before_anything_is_sent_and_no_key_is_printed(
    panoloc: Panoloc, fake: FakeService, monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(name, value)
    done = panoloc("maps")
    assert (done.code, fake.requests) == (ExitCode.ERROR, [])
    assert name in done.err
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


@pytest.mark.parametrize("arguments", [("changes", "m", "--format", "xml"), ("keys", "make", "a", "--scope", "foo")])
def test_a_value_that_an_option_does_not_take_is_refused_with_those_that_it_takes(
    panoloc: Panoloc, arguments: tuple[str, ...]
) -> None:
    done = panoloc(*arguments)
    assert done.code == ExitCode.USAGE
    assert f"Invalid value for '{arguments[-2]}': '{arguments[-1]}' is not one of" in done.said
