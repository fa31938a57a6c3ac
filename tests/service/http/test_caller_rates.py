"""How much callers may ask for over time: counted together and, while Redis is away, alone; and what they are told."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path

import pytest

from panoloc.service.errors import RateError
from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.limits import caller_rates
from panoloc.service.limits.caller_rates import CallerRates
from tests.service.http.running_service import SCAN, RunningService, Serve

pytestmark = pytest.mark.anyio


RatesOf = Callable[..., CallerRates]


class Refusals(list[str]):
    def note(self, limit: str) -> None:
        self.append(limit)


async def num_let_through(rates: CallerRates, times: int, caller: str = "key one") -> int:
    through = 0
    for _ in range(times):
        try:
            await rates.take(caller, False)
        except RateError:
            continue
        through += 1
    return through


@pytest.fixture
async def rates_of(redis_server: EmbeddedRedis) -> AsyncIterator[RatesOf]:
    """Return what makes rates that are closed after the test; url: of another Redis, or None for no one's."""
    made, unheard = list[CallerRates](), Refusals().note

    def make(
        requests: int | None,
        num_bytes: int | None,
        note: Callable[[str], None] = unheard,
        url: str | None = redis_server.url,
    ) -> CallerRates:
        made.append(CallerRates(url, requests, num_bytes, note))
        return made[-1]

    yield make
    for rates in made:
        await rates.close()


@pytest.mark.parametrize("where", ["together", "alone"])
async def test_of_each_caller_so_many_requests_are_let_through(rates_of: RatesOf, where: str) -> None:
    refusals = Refusals()
    rates = rates_of(5, None, refusals.note, **({} if where == "together" else {"url": None}))
    assert await num_let_through(rates, 8, f"key {where}") == 5
    assert await num_let_through(rates, 3, f"key {where} too") == 3
    assert refusals == ["request-rate"] * 3
    with pytest.raises(RateError, match=r"at most 5 requests of one caller in a minute \(PANOLOC_MAX_REQUESTS") as told:
        await rates.take(f"key {where}", False)
    assert 1 <= told.value.retry_after_s <= 60


async def test_replicas_count_together(rates_of: RatesOf) -> None:
    first, second = (rates_of(6, None) for _ in range(2))
    assert await num_let_through(first, 4, "key shared") == 4
    assert await num_let_through(second, 4, "key shared") == 2


async def test_who_has_sent_too_many_bytes_waits(rates_of: RatesOf) -> None:
    rates = rates_of(None, 1000)
    for num_bytes in (600, 600):  # the second goes beyond it, and is answered
        await rates.take("key sender", True)
        await rates.spend("key sender", num_bytes)
    with pytest.raises(RateError, match=r"at most 1,000 bytes of one caller in an hour") as told:
        await rates.take("key sender", True)
    assert 1 <= told.value.retry_after_s <= 3600
    await rates.take("key sender", False)
    await rates.take("key other", True)


async def test_without_redis_each_process_counts_for_itself(
    rates_of: RatesOf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    rates = rates_of(2, None, url=f"unix://{tmp_path}/nobody.sock")
    assert await num_let_through(rates, 4) == 2
    assert caplog.text.count("this process counts the rates") == 1, "each request asked how Redis is"
    monkeypatch.setattr(caller_rates, "_PAUSE_S", 0.0)
    rates._alone_until_s = 0.0
    assert await num_let_through(rates, 1, "key late") == 1
    assert caplog.text.count("this process counts the rates") == 2


async def test_who_asks_too_often_is_told_when_to_ask_again_and_others_are_answered(serve: Serve) -> None:
    settings = {"api_keys": "the-first-key,the-second-key", "max_requests_per_minute": 3}
    async with serve(**settings) as running:

        async def status(key: str, path: str = "/maps") -> int:
            return (await running.client.get(path, headers={"Authorization": f"Bearer {key}"})).status_code

        assert [await status("the-first-key") for _ in range(5)] == [200, 200, 200, 429, 429]
        assert await status("the-second-key") == 200
        assert [await status("the-first-key", path) for path in ("/health/live", "/")] == [200, 200]
        refused = await running.client.get("/maps", headers={"X-API-Key": "the-first-key"})
        assert refused.json()["type"] == "/problems/too-often"
        assert 1 <= int(refused.headers["retry-after"]) <= 60
        assert "PANOLOC_MAX_REQUESTS_PER_MINUTE" in refused.json()["detail"]
        assert 'panoloc_refusals_total{limit="request-rate"} 3.0' in running.app.state.services.metrics.text().decode()


@pytest.mark.settings(max_bytes_per_hour=100)
async def test_a_scan_beyond_the_bytes_is_taken_and_the_next_request_refused_unread(running: RunningService) -> None:
    assert (await running.upload()).status_code == 202
    refused = await running.upload(SCAN * 100_000)
    assert (refused.status_code, refused.json()["type"]) == (429, "/problems/too-often")
    assert refused.headers["connection"] == "close"
    assert "smaller images" in refused.json()["detail"]
    assert await running.status("GET", "/maps") == 200
    map_id = (await running.json("/maps"))["items"][0]["id"]
    assert (await running.client.patch(f"/maps/{map_id}", json={"name": "hall"})).status_code == 200


async def test_without_limits_nothing_is_counted(serve: Serve) -> None:
    rates = CallerRates("unix:///nowhere.sock", None, None, Refusals().note)
    assert await num_let_through(rates, 100) == 100
    async with serve() as running:
        assert not running.app.state.services.rates.are_limited
