"""How much one caller may ask for over time: counted in Redis, for all front doors together."""

import logging
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TypeVar

from limits import RateLimitItemPerHour, RateLimitItemPerMinute
from limits.aio.storage import MemoryStorage, RedisStorage
from limits.aio.strategies import FixedWindowRateLimiter, SlidingWindowCounterRateLimiter
from redis.asyncio import ConnectionPool
from redis.exceptions import RedisError

from service.errors import RateError
from service.limits.capacity import Refusal

_T = TypeVar("_T")

_log = logging.getLogger(__name__)

_PREFIX = "rate"
_TIMEOUT_S = 1.0
# A Redis that does not answer is not asked by every request how it is.
_PAUSE_S = 5.0


@dataclass(frozen=True)
class RateLimits:
    """Limits of the settings of the same names, None for none."""

    requests_per_minute: int | None
    bytes_per_hour: int | None


class CallerRates:
    """Used from one event loop. While Redis is away each process counts for itself."""

    def __init__(self, redis_url: str | None, limits: RateLimits, note_refusal: Callable[[Refusal], None]) -> None:
        """redis_url: None to count for this process alone. note_refusal: told which limit refused something."""
        self.limits = limits
        self._note_refusal = note_refusal
        self._alone = _Counts(MemoryStorage(), limits)
        self._pool, self._together = None, None
        if redis_url is not None and self.are_limited:
            self._pool = ConnectionPool.from_url(
                redis_url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S
            )
            self._together = _Counts(_storage(redis_url, self._pool), limits)
        self._alone_until_s = -math.inf

    @property
    def are_limited(self) -> bool:
        """Tell whether there is any limit."""
        return self.limits != RateLimits(None, None)

    async def take(self, caller: str, brings_bytes: bool) -> None:
        """Count a request. Raises RateError where there were too many of them, or one that brings bytes comes after too many."""
        refused = await self._counted(lambda counts: counts.refusal(caller, brings_bytes))
        if refused is None:
            return
        limit, wait_s = refused
        retry_after_s = max(1, math.ceil(wait_s))
        self._note_refusal(limit)
        told = (
            f"expected at most {self.limits.bytes_per_hour:,} bytes of one caller in an hour (PANOLOC_MAX_BYTES_PER_HOUR), got more; send "
            f"smaller images or fewer, and the next upload in {retry_after_s} s; what brings no bytes is answered"
            if limit == "byte-rate"
            else f"expected at most {self.limits.requests_per_minute:,} requests of one caller in a minute "
            f"(PANOLOC_MAX_REQUESTS_PER_MINUTE), got more; ask less often, the next time in {retry_after_s} s"
        )
        raise RateError(told, retry_after_s)

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
                _log.warning("the rates of callers are counted by this process alone", extra={"error": str(error)})
        return await count(self._alone)


class _Counts:
    """What callers have asked for, in one storage."""

    def __init__(self, storage: MemoryStorage | RedisStorage, limits: RateLimits) -> None:
        self._requests, self._bytes = limits.requests_per_minute, limits.bytes_per_hour
        # Requests evenly, so that a minute's worth of them is not followed at once by that of the next; of bytes one upload may be
        # more than the limit, which only whole windows can count.
        self._of_requests, self._of_bytes = SlidingWindowCounterRateLimiter(storage), FixedWindowRateLimiter(storage)

    async def refusal(self, caller: str, brings_bytes: bool) -> tuple[Refusal, float] | None:
        """Count a request, or return which limit is against it, and for how many seconds."""
        if self._bytes is not None and brings_bytes:
            bytes_item = RateLimitItemPerHour(self._bytes)
            if not await self._of_bytes.test(bytes_item, caller):
                return "byte-rate", (await self._of_bytes.get_window_stats(bytes_item, caller)).reset_time - time.time()
        if self._requests is not None:
            item = RateLimitItemPerMinute(self._requests)
            if not await self._of_requests.hit(item, caller):
                return "request-rate", (await self._of_requests.get_window_stats(item, caller)).reset_time - time.time()
        return None

    async def spend(self, caller: str, num_bytes: int) -> None:
        """Count bytes."""
        if self._bytes is not None:
            await self._of_bytes.hit(RateLimitItemPerHour(self._bytes), caller, cost=num_bytes)


def _storage(redis_url: str, pool: ConnectionPool) -> RedisStorage:
    # The library wants a URL of its own kind, although the pool is what is used.
    scheme, _, rest = redis_url.partition("://")
    url = f"async+{'redis+unix' if scheme == 'unix' else scheme}://{rest}"
    return RedisStorage(url, implementation="redispy", key_prefix=_PREFIX, connection_pool=pool)  # type: ignore[arg-type]
