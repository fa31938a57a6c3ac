"""How much one caller may ask for over time, counted in Redis for all API replicas together; and how soon wrong keys are refused."""

import asyncio
import logging
import math
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import TypeVar

from limits import RateLimitItemPerHour, RateLimitItemPerMinute
from limits.aio.storage import MemoryStorage, RedisStorage
from limits.aio.strategies import FixedWindowRateLimiter, RateLimiter, SlidingWindowCounterRateLimiter
from redis.asyncio import ConnectionPool
from redis.exceptions import RedisError

from panoloc.service.errors import RateError, WrongKeysError
from panoloc.service.limits.capacity import Refusal

_T = TypeVar("_T")

_log = logging.getLogger(__name__)

_PREFIX = "rate"
_TIMEOUT_S = 1.0
# After a failure, requests do not try Redis for so long.
_PAUSE_S = 5.0
_WRONG_KEY_S = 1.0
_MOST_WRONG_KEYS = 8  # that wait


class CallerRates:
    """Used from one event loop. While Redis is away each process counts for itself."""

    def __init__(
        self,
        redis_url: str | None,
        requests_per_minute: int | None,
        bytes_per_hour: int | None,
        note_refusal: Callable[[Refusal], None],
    ) -> None:
        """redis_url: None to count for this process alone. Limits: None for none. note_refusal: called with the limit that was hit."""
        self.requests_per_minute, self.bytes_per_hour = requests_per_minute, bytes_per_hour
        self._note_refusal = note_refusal
        self._alone = _Counts(MemoryStorage(), requests_per_minute, bytes_per_hour)
        self._pool, self._together = None, None
        if redis_url is not None and self.are_limited:
            self._pool = ConnectionPool.from_url(
                redis_url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S
            )
            self._together = _Counts(_storage(redis_url, self._pool), requests_per_minute, bytes_per_hour)
        self._alone_until_s = -math.inf

    @property
    def are_limited(self) -> bool:
        """Tell whether there is any limit."""
        return (self.requests_per_minute, self.bytes_per_hour) != (None, None)

    async def take(self, caller: str, brings_bytes: bool) -> None:
        """Count a request. Raises RateError after too many, and for one that brings bytes also after too many bytes."""
        refused = await self._counted(lambda counts: counts.refusal(caller, brings_bytes))
        if refused is None:
            return
        limit, wait_s = refused
        retry_after_s = max(1, math.ceil(wait_s))
        self._note_refusal(limit)
        if limit == "byte-rate":
            raise RateError(
                f"expected at most {self.bytes_per_hour:,} bytes of one caller in an hour "
                f"(PANOLOC_MAX_BYTES_PER_HOUR), got more; wait {retry_after_s} s before the next upload, or send "
                "smaller images or fewer; requests without uploads are still answered",
                retry_after_s,
            )
        raise RateError(
            f"expected at most {self.requests_per_minute:,} requests of one caller in a minute "
            f"(PANOLOC_MAX_REQUESTS_PER_MINUTE), got more; send fewer requests, the next one in {retry_after_s} s",
            retry_after_s,
        )

    async def headers(self, caller: str) -> dict[str, str]:
        """Return what a caller may know of his requests (IETF draft "RateLimit header fields for HTTP"); empty without a limit."""
        limit = self.requests_per_minute
        if limit is None:
            return {}
        num_left, wait_s = await self._counted(lambda counts: counts.left(caller))
        return {"RateLimit-Policy": f'"requests";q={limit};w=60', "RateLimit": f'"requests";r={num_left};t={wait_s}'}

    async def spend(self, caller: str, num_bytes: int) -> None:
        """Count the bytes that a request brought."""
        if num_bytes:
            await self._counted(lambda counts: counts.spend(caller, num_bytes))

    async def close(self) -> None:
        """Close the connections."""
        if self._pool is not None:
            await self._pool.aclose()

    async def _counted(self, count: "Callable[[_Counts], Awaitable[_T]]") -> _T:
        if self._together is not None and time.monotonic() >= self._alone_until_s:
            try:
                return await count(self._together)
            except (RedisError, OSError) as error:
                self._alone_until_s = time.monotonic() + _PAUSE_S
                _log.warning("this process counts the rates of callers alone", extra={"error": str(error)})
        return await count(self._alone)


class WrongKeys:
    """Slows down callers who try keys: a wrong key is refused after a pause for each that this address has waiting.

    Used from one event loop. Right keys never wait, even of an address that many share."""

    def __init__(self, pause_s: float = _WRONG_KEY_S, most_waiting: int = _MOST_WRONG_KEYS) -> None:
        self._pause_s = pause_s
        self._most_waiting = most_waiting
        self._waiting: Counter[str] = Counter()

    async def wait(self, address: str) -> None:
        """Wait before a wrong key of this address is refused. Raises WrongKeysError where many wait already."""
        if self._waiting[address] >= self._most_waiting:
            raise WrongKeysError(
                f"expected a known API key, got {self._most_waiting} unknown ones from this address within seconds; "
                "ask the operator for a key",
                round(self._most_waiting * self._pause_s) or 1,
            )
        self._waiting[address] += 1
        try:
            await asyncio.sleep(self._pause_s * self._waiting[address])
        finally:
            self._waiting[address] -= 1
            if not self._waiting[address]:
                del self._waiting[address]


class _Counts:
    """What callers have asked for, in one storage."""

    def __init__(self, storage: MemoryStorage | RedisStorage, requests: int | None, num_bytes: int | None) -> None:
        # A sliding window spreads requests over the minute. Of bytes, one upload may be more than the limit, which only
        # fixed windows can count.
        self._sliding, self._fixed = SlidingWindowCounterRateLimiter(storage), FixedWindowRateLimiter(storage)
        self._requests = None if requests is None else RateLimitItemPerMinute(requests)
        self._bytes = None if num_bytes is None else RateLimitItemPerHour(num_bytes)

    async def refusal(self, caller: str, brings_bytes: bool) -> tuple[Refusal, float] | None:
        """Count a request, or return which limit is against it, and for how many seconds."""
        if self._bytes is not None and brings_bytes and not await self._fixed.test(self._bytes, caller):
            return "byte-rate", await _wait_s(self._fixed, self._bytes, caller)
        if self._requests is not None and not await self._sliding.hit(self._requests, caller):
            return "request-rate", await _wait_s(self._sliding, self._requests, caller)
        return None

    async def left(self, caller: str) -> tuple[int, int]:
        """Return how many requests are left, and in how many seconds there are more."""
        assert self._requests is not None, "there is a limit of requests"
        window = await self._sliding.get_window_stats(self._requests, caller)
        return max(0, window.remaining), max(0, math.ceil(window.reset_time - time.time()))

    async def spend(self, caller: str, num_bytes: int) -> None:
        """Count bytes."""
        if self._bytes is not None:
            await self._fixed.hit(self._bytes, caller, cost=num_bytes)


async def _wait_s(limiter: RateLimiter, item: RateLimitItemPerHour | RateLimitItemPerMinute, caller: str) -> float:
    return (await limiter.get_window_stats(item, caller)).reset_time - time.time()


def _storage(redis_url: str, pool: ConnectionPool) -> RedisStorage:
    # The library wants a URL of its own kind, although it uses the pool.
    scheme, _, rest = redis_url.partition("://")
    url = f"async+{'redis+unix' if scheme == 'unix' else scheme}://{rest}"
    return RedisStorage(url, implementation="redispy", key_prefix=_PREFIX, connection_pool=pool)  # type: ignore[arg-type]
