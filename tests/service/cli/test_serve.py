"""`panoloc serve` before the service starts: options, settings, and wrong ones."""

import sys
import types
from pathlib import Path

import pytest

from panoloc.service.cli import serve
from panoloc.service.settings import Settings
from tests.service.cli.commands import Panoloc


@pytest.fixture
def started_with(monkeypatch: pytest.MonkeyPatch) -> list[Settings]:
    """Replace the service by one that only keeps its settings, on a machine whose addresses are all free."""
    kept: list[Settings] = []
    module = types.ModuleType("panoloc.service.serve")
    module.run_service = kept.append  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "panoloc.service.serve", module)
    monkeypatch.setattr(serve, "why_not_free", lambda host, port: None)
    return kept


def test_options_win_over_the_environment(
    panoloc: Panoloc, started_with: list[Settings], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PANOLOC_PORT", "9001")
    monkeypatch.setenv("PANOLOC_LOG_FORMAT", "json")
    monkeypatch.setenv("RAY_ADDRESS", "ray.example:6379")
    done = panoloc("serve", "--port", 9002, "--data-dir", tmp_path, "--workers", 3, "--log-level", "WARNING")
    assert done.code == 0, done.err
    (settings,) = started_with
    assert settings.port == 9002
    assert settings.log_format == "json"
    assert settings.ray_address == "ray.example:6379"
    assert settings.data_dir == tmp_path
    assert settings.num_workers == 3
    assert settings.log_level == "warning"


def test_every_option_reaches_its_setting(panoloc: Panoloc, started_with: list[Settings]) -> None:
    panoloc("serve", "--host", "::1", "--redis-url", "redis://r", "--ray-address", "a:1", "--log-format", "json")
    (settings,) = started_with
    assert (settings.host, settings.redis_url) == ("::1", "redis://r")
    assert (settings.ray_address, settings.log_format) == ("a:1", "json")


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"MAX_MAPS": "many"}, "Setting PANOLOC_MAX_MAPS: "),
        ({"API_KEYS": "secret-key-1:everything"}, "Setting PANOLOC_API_KEYS: "),
        ({"API_KEYS": "secret"}, "Setting PANOLOC_API_KEYS: key 1: expected at least 8"),
        (
            {"API_KEYS": "secret-key-1", "OIDC_ISSUER": "https://login.example.org"},
            "Settings: expected PANOLOC_OIDC_AUDIENCE and PANOLOC_OIDC_KEYS as well",
        ),
        ({"STORAGE": "ftp://user:secret@host/x"}, "Setting PANOLOC_STORAGE: "),
        ({"MAX_MAPS": "ftp://user:secret@host/x"}, "Setting PANOLOC_MAX_MAPS: "),
        *(
            ({"REDIS_URL": url}, "PANOLOC_REDIS_URL: expected redis://host:port/0")
            for url in ("http://host", "redis://:secret@host:port/0", "host:6379")
        ),
        *(
            ({"RAY_ADDRESS": address}, "PANOLOC_RAY_ADDRESS or RAY_ADDRESS: expected host:port")
            for address in ("nonsense", "ray.example", ":6379", "ray.example:", "ray.example:99999")
        ),
        *(
            ({"ALLOWED_HOSTS": hosts}, "PANOLOC_ALLOWED_HOSTS: expected names such as panoloc.example.org")
            for hosts in ("https://maps.example", "maps.example:8000", "a b", "maps.example,/x")
        ),
    ],
)
def test_a_wrong_setting_is_named_without_secrets_before_anything_starts(
    panoloc: Panoloc,
    started_with: list[Settings],
    monkeypatch: pytest.MonkeyPatch,
    variables: dict[str, str],
    said: str,
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(f"PANOLOC_{name}", value)
    done = panoloc("serve")
    assert (done.code, started_with) == (2, [])
    assert said in done.said
    assert "secret" not in done.err + done.out


@pytest.mark.parametrize(("name", "value"), [("PANOLOC_STORAGE", "ftp://host/x"), ("PANOLOC_MAX_MAPS", "many")])
def test_a_wrong_value_is_shown_once(panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    assert "".join(panoloc("serve").err.split()).count(value) == 1


def test_a_setting_that_is_none_is_named_with_the_one_that_was_meant(
    panoloc: Panoloc, started_with: list[Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_QUEU_LIMIT", "3")
    monkeypatch.setenv("PANOLOC_URL", "http://127.0.0.1:8123")
    done = panoloc("serve")
    assert "PANOLOC_QUEU_LIMIT is no setting; did you mean PANOLOC_QUEUE_LIMIT?" in done.err
    assert "PANOLOC_URL" not in done.err
    assert len(started_with) == 1
