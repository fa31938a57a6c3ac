"""The log says when Redis goes away and when it is back, once each, and never its password."""

import asyncio
import logging

import pytest

from panoloc.service.errors import CacheDownError
from panoloc.service.host.redis_watch import watch_redis


class FlakyCache:
    """Answers as told, look after look, then ends the watch."""

    def __init__(self, answers: list[bool]) -> None:
        self._answers = answers

    async def check_writable(self) -> None:
        if not self._answers:
            raise asyncio.CancelledError
        if not self._answers.pop(0):
            raise CacheDownError("connection refused", 2)


@pytest.mark.parametrize(
    ("answers", "levels"),
    [
        ([True, True], []),
        ([False, False, False], ["WARNING"]),
        ([True, False, False, True, True, False], ["WARNING", "INFO", "WARNING"]),
    ],
)
def test_changes_are_logged_once(answers: list[bool], levels: list[str], caplog: pytest.LogCaptureFixture) -> None:
    cache = FlakyCache(answers)
    with caplog.at_level(logging.INFO, "panoloc.service.host.redis_watch"), pytest.raises(asyncio.CancelledError):
        asyncio.run(watch_redis(cache, "redis://:secret@cache.example:7000/0", 0.0))  # type: ignore[arg-type]
    logged = [record for record in caplog.records if record.name == "panoloc.service.host.redis_watch"]
    assert [record.levelname for record in logged] == levels
    assert all(vars(record)["redis"] == "cache.example:7000" for record in logged)
    assert "secret" not in str([vars(record) for record in logged])
