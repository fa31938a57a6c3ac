"""Settings and the keys in them: what does not go together is refused before anything starts."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from panoloc.service.keys.caller import ALL_SCOPES
from panoloc.service.keys.key_ring import KeyRing
from panoloc.service.settings import Settings


def test_replicas_that_share_a_folder_need_one_redis_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with pytest.raises(ValidationError, match="PANOLOC_REDIS_URL"):
        Settings(shared=True)
    assert Settings(shared=True, redis_url="redis://cache:6379/0").shared


def test_replicas_that_share_a_folder_may_join_one_cluster() -> None:
    settings = Settings(shared=True, redis_url="redis://cache:6379/0", ray_address="head:6379")
    assert (settings.shared, settings.ray_address) == (True, "head:6379")


def test_a_storage_is_a_bucket_or_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = Settings(data_dir=tmp_path)
    assert (plain.storage_url, plain.has_bucket, plain.bucket_access) == (str(tmp_path), False, None)
    monkeypatch.setenv("PANOLOC_STORAGE", "")
    assert Settings(data_dir=tmp_path).storage_url == str(tmp_path)
    bucket = Settings(data_dir=tmp_path / "data", storage="s3://scans/panoloc")
    assert (bucket.storage_url, bucket.has_bucket) == ("s3://scans/panoloc", True)
    assert bucket.bucket_access is not None
    assert bucket.bucket_access.local_folder == str(tmp_path / "data")
    elsewhere = Settings(data_dir=tmp_path / "data", storage=f"file://{tmp_path}/scans")
    assert (elsewhere.storage_url, elsewhere.has_bucket) == (f"{tmp_path}/scans", False)


@pytest.mark.parametrize("url", ["scans", "http://scans", "s3://", "s3://id:secret@scans"])
def test_a_storage_that_is_no_url_is_refused(url: str) -> None:
    with pytest.raises(ValidationError, match=r"expected s3://bucket/prefix|expected no key in the URL"):
        Settings(storage=url)


def test_a_key_may_do_what_its_scope_says(tmp_path: Path) -> None:
    keys = KeyRing("all-of-it, only-look:read, writes-too:write, only-ask:localize", tmp_path)
    assert scopes_of(keys, "all-of-it") == ALL_SCOPES
    assert scopes_of(keys, "only-look") == {"read", "localize"}
    assert scopes_of(keys, "only-ask") == {"localize"}
    assert scopes_of(keys, "writes-too") == {"read", "localize", "write"}
    assert keys.find("only-loo") is None
    assert not KeyRing("", tmp_path).required


def scopes_of(keys: KeyRing, key: str) -> frozenset[str]:
    caller = keys.find(key)
    assert caller is not None
    assert caller.tenant is None
    return frozenset[str](caller.scopes)


@pytest.mark.parametrize("keys", ["short", "long-enough:admin", "ünicode-key"])
def test_a_wrong_key_in_the_settings_is_named_but_not_shown(keys: str) -> None:
    with pytest.raises(ValidationError) as caught:
        Settings(api_keys=keys)
    message = caught.value.errors()[0]["msg"]
    assert "key 1" in message
    assert keys.partition(":")[0] not in message


def test_settings_come_from_the_environment_and_arguments_win(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOLOC_PORT", "9001")
    monkeypatch.setenv("PANOLOC_MAX_MAPS", "7")
    monkeypatch.setenv("RAY_ADDRESS", "ray://head:10001")
    monkeypatch.setenv("PANOLOC_REDIS_URL", "")
    settings = Settings(port=9002)
    assert (settings.port, settings.max_maps) == (9002, 7)
    assert settings.ray_address == "ray://head:10001"
    assert settings.redis_url is None
    monkeypatch.setenv("PANOLOC_PORT", "no number")
    with pytest.raises(ValidationError, match="port"):
        Settings()


def test_the_log_level_may_have_capitals(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOLOC_LOG_LEVEL", "INFO")
    assert Settings().log_level == "info"
    monkeypatch.setenv("PANOLOC_LOG_LEVEL", "loud")
    with pytest.raises(ValidationError, match="'debug', 'info', 'warning' or 'error'"):
        Settings()


def test_keys_are_not_printed_with_the_settings() -> None:
    assert "secret-key" not in repr(Settings(api_keys="secret-key"))
