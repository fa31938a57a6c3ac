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
    done = panoloc("serve", "--port", 9002, "--data-dir", tmp_path, "--workers", 3, "--log-level", "warning")
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


@pytest.mark.parametrize("address", ["nonsense", "ray.example", ":6379", "ray.example:", "ray.example:99999"])
def test_an_address_that_no_cluster_has_is_refused_at_once(
    panoloc: Panoloc, started_with: list[Settings], address: str
) -> None:
    done = panoloc("serve", "--ray-address", address)
    assert done.code == 2
    assert "PANOLOC_RAY_ADDRESS or RAY_ADDRESS: expected host:port" in " ".join(done.err.split())
    assert started_with == []


def test_a_wrong_setting_is_named_with_its_value(
    panoloc: Panoloc, started_with: list[Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_MAX_MAPS", "many")
    done = panoloc("serve")
    assert done.code == 2
    assert "PANOLOC_MAX_MAPS" in done.err
    assert "'many'" in done.err
    assert started_with == []


def test_a_wrong_key_is_never_printed(
    panoloc: Panoloc, started_with: list[Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_API_KEYS", "secret-key-1:everything")
    done = panoloc("serve")
    assert done.code == 2
    assert "PANOLOC_API_KEYS" in done.err
    assert "secret-key-1" not in done.err + done.out


@pytest.mark.parametrize("name", ["PANOLOC_STORAGE", "PANOLOC_MAX_MAPS"])
def test_a_password_in_a_wrong_url_is_never_printed(
    panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv(name, "ftp://user:secret-word@host/x")
    done = panoloc("serve")
    assert done.code == 2
    assert name in done.err
    assert "secret-word" not in done.err + done.out


@pytest.mark.parametrize("url", ["http://host", "redis://:secret-word@host:port/0", "host:6379"])
def test_a_wrong_redis_is_named_before_anything_starts(
    panoloc: Panoloc, started_with: list[Settings], monkeypatch: pytest.MonkeyPatch, url: str
) -> None:
    monkeypatch.setenv("PANOLOC_REDIS_URL", url)
    done = panoloc("serve")
    assert (done.code, started_with) == (2, [])
    assert "PANOLOC_REDIS_URL: expected redis://host:port/0" in " ".join(done.err.split())
    assert "secret-word" not in done.err


def test_a_wrong_storage_is_named_once(panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOLOC_STORAGE", "ftp://host/x")
    assert "".join(panoloc("serve").err.split()).count("ftp://host/x") == 1


@pytest.mark.parametrize("hosts", ["https://maps.example", "maps.example:8000", "a b", "maps.example,/x"])
def test_hosts_that_no_request_can_name_are_refused(
    panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch, hosts: str
) -> None:
    monkeypatch.setenv("PANOLOC_ALLOWED_HOSTS", hosts)
    done = panoloc("serve")
    assert done.code == 2
    assert "PANOLOC_ALLOWED_HOSTS: expected names such as panoloc.example.org" in " ".join(done.err.split())


def test_settings_that_do_not_go_together_are_explained_without_the_values_of_others(
    panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_API_KEYS", "secret-key-1")
    monkeypatch.setenv("PANOLOC_OIDC_ISSUER", "https://login.example.org")
    done = panoloc("serve")
    assert done.code == 2
    assert "Settings: expected PANOLOC_OIDC_AUDIENCE and PANOLOC_OIDC_KEYS as well" in " ".join(done.err.split())
    assert "secret-key-1" not in done.err + done.out


def test_a_wrong_key_is_explained_without_the_jargon_of_the_validator(
    panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_API_KEYS", "short")
    done = panoloc("serve")
    assert done.code == 2
    assert "Setting PANOLOC_API_KEYS: key 1: expected at least 8" in done.err


def test_a_setting_that_is_none_is_named_with_the_one_that_was_meant(
    panoloc: Panoloc, started_with: list[Settings], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOLOC_QUEU_LIMIT", "3")
    monkeypatch.setenv("PANOLOC_URL", "http://127.0.0.1:8123")
    done = panoloc("serve")
    assert "PANOLOC_QUEU_LIMIT is no setting; did you mean PANOLOC_QUEUE_LIMIT?" in done.err
    assert "PANOLOC_URL" not in done.err
    assert len(started_with) == 1
