"""Settings that do not go together are refused before anything starts."""

import pytest
from pydantic import ValidationError

from service.settings import Settings


def test_front_doors_that_share_a_folder_need_one_redis_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with pytest.raises(ValidationError, match="PANOLOC_REDIS_URL"):
        Settings(shared=True)
    assert Settings(shared=True, redis_url="redis://cache:6379/0").shared


def test_front_doors_that_share_a_folder_may_join_one_cluster() -> None:
    settings = Settings(shared=True, redis_url="redis://cache:6379/0", ray_address="head:6379")
    assert (settings.shared, settings.ray_address) == (True, "head:6379")
