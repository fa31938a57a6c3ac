"""Client commands look for the service where one started with the same environment listens."""

import pytest

from service.cli.session import default_url


def test_the_default_url_follows_host_and_port(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOLOC_HOST", "0.0.0.0")
    monkeypatch.setenv("PANOLOC_PORT", "8177")
    assert default_url() == "http://127.0.0.1:8177"


def test_without_settings_the_default_url_is_the_documented_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PANOLOC_HOST", raising=False)
    monkeypatch.delenv("PANOLOC_PORT", raising=False)
    assert default_url() == "http://127.0.0.1:8000"
