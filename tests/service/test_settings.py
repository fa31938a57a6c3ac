"""Settings that do not go together are refused before anything starts."""

from pathlib import Path

import pytest
from pydantic import ValidationError

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


def test_replicas_that_share_a_bucket_need_one_redis_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with pytest.raises(ValidationError, match="expected PANOLOC_REDIS_URL with PANOLOC_SHARED"):
        Settings(shared=True, storage="s3://scans")
