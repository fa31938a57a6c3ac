"""The page on the HTTP API and the curl examples fit what the service offers."""

import re
from typing import Any
from unittest.mock import Mock

import pytest

from panoloc.service.app import create_app
from panoloc.service.settings import Settings
from tests.docs.documentation import PAGES, ROOT, shell_commands

CURL = [(page, words) for page in PAGES for words in shell_commands(page) if words[0] == "curl"]


@pytest.fixture(scope="module")
def paths() -> dict[str, Any]:
    """Return the paths of the OpenAPI document, with every parameter written as {id}."""
    settings = Settings(redis_url="redis://127.0.0.1:1", data_dir=ROOT / "nowhere")
    # The document is made without a request, so none of these is ever asked for anything.
    app = create_app(settings, Mock(), Mock())
    return {re.sub(r"\{\w+\}", "{id}", path): operations for path, operations in app.openapi()["paths"].items()}


def test_the_page_lists_every_call_and_no_other(paths: dict[str, Any]) -> None:
    page = " ".join((ROOT / "docs" / "api.md").read_text(encoding="utf-8").split())
    listed = set(re.findall(r"`(GET|POST|PUT|PATCH|DELETE) (/[^`?]*)`", page))
    offered = {(method.upper(), path) for path, operations in paths.items() for method in operations}
    assert listed - offered == set()
    assert {call for call in offered if call[1] != "/"} - listed == set()


@pytest.mark.parametrize(("page", "words"), CURL, ids=lambda value: getattr(value, "name", None))
def test_every_curl_example_sends_fields_that_the_call_takes(
    paths: dict[str, Any], page: Any, words: list[str]
) -> None:
    (url,) = [word for word in words if word.startswith("http")]
    form = paths["/" + url.split("/", 3)[3]]["post"]["requestBody"]["content"]["multipart/form-data"]["schema"]
    sent = {words[number + 1].partition("=")[0] for number, word in enumerate(words) if word == "-F"}
    assert sent
    assert sent <= set(form["properties"])
    assert set(form.get("required", [])) <= sent
