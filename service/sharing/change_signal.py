"""Publishes the ids of changed maps and batches to the other API replicas: a short stream in Redis.

It only makes them look at once: the storage is what counts, and every replica looks there regularly as well.
"""

import contextlib
import secrets
from collections.abc import Awaitable, Callable
from typing import Any

import structlog
from redis.asyncio import Redis
from redis.exceptions import RedisError

_log = structlog.get_logger(__name__)

_STREAM = "panoloc:changed"
_TIMEOUT_S = 0.5
_MOST_KEPT = 1000
_LIFETIME_S = 60


Publish = Callable[[str], Awaitable[None]]
"""Publishes the id of a changed map or batch."""


async def publish_nothing(name: str) -> None:
    """Stand in for publishing where there is no other replica."""


class ChangeSignal:
    """Used from one event loop."""

    def __init__(self, url: str) -> None:
        self._redis: Redis = Redis.from_url(url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S)
        # A replica knows its own changes.
        self._own_name = secrets.token_hex(8)
        # The ids of a stream begin with the time, so that those after Redis was emptied are greater still.
        self._last_id = "0-0"

    async def publish(self, name: str) -> None:
        """Publish the id of a map or batch that was changed, made or deleted; does nothing without Redis."""
        with contextlib.suppress(RedisError, OSError):
            async with self._redis.pipeline(transaction=False) as pipe:
                pipe.xadd(_STREAM, {"id": name, "by": self._own_name}, maxlen=_MOST_KEPT, approximate=True)
                pipe.expire(_STREAM, _LIFETIME_S)
                await pipe.execute()

    async def poll(self) -> list[str]:
        """Return the ids that others have published since the last call, at first those of the last minute."""
        try:
            found: Any = await self._redis.xrange(_STREAM, min=f"({self._last_id}")
        except (RedisError, OSError) as error:
            _log.debug("Redis does not answer; changes of other API replicas are found by polling", error=str(error))
            return []
        if found:
            self._last_id = found[-1][0].decode()
        return [entry[b"id"].decode() for _, entry in found if entry[b"by"].decode() != self._own_name]

    async def close(self) -> None:
        """Close the connections."""
        await self._redis.aclose()
