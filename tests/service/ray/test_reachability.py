import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from service.host.embedded_redis import EmbeddedRedis
from service.host.lifeline import Lifeline
from service.host.service_version import service_version
from service.ray.reachability import leave_token, missing_here, take_token_back
from service.settings import Settings
from service.worker.plan import WorkerSettings


@pytest.fixture
def settings() -> Iterator[WorkerSettings]:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        lifeline = Lifeline()
        server = EmbeddedRedis(Path(folder), lifeline)
        server.start()
        yield WorkerSettings.of(Settings(data_dir=Path(folder)), server.url)
        server.stop()
        lifeline.close()


def test_where_both_are_reached_nothing_is_missing(settings: WorkerSettings) -> None:
    assert missing_here(settings, leave_token(settings), service_version()) == []


def test_an_absent_redis_is_named_without_its_password(settings: WorkerSettings) -> None:
    absent = replace(settings, redis_url="redis://:secret@127.0.0.1:1/0")
    (fault,) = missing_here(absent, leave_token(settings), service_version())
    assert "127.0.0.1:1/0" in fault
    assert "PANOLOC_REDIS_URL" in fault
    assert "secret" not in fault


def test_another_folder_under_the_same_name_is_noticed(settings: WorkerSettings, tmp_path: Path) -> None:
    elsewhere = replace(settings, storage_url=str(tmp_path))
    leave_token(elsewhere)
    (fault,) = missing_here(elsewhere, leave_token(settings), service_version())
    assert "PANOLOC_DATA_DIR" in fault


def test_another_version_is_named_with_ours(settings: WorkerSettings) -> None:
    (fault,) = missing_here(settings, leave_token(settings), "0.0.1")
    assert f"expected panoloc 0.0.1, got {service_version()}" in fault


def test_tokens_of_several_who_ask_do_not_meet_and_none_is_left(settings: WorkerSettings) -> None:
    mine, theirs = leave_token(settings), leave_token(settings)
    take_token_back(settings, theirs)
    assert missing_here(settings, mine, service_version()) == []
    take_token_back(settings, mine)
    assert settings.open_storage().names("cluster") == []
