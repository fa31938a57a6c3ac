"""Word of changed maps and batches from one front door to the others: a short stream in Redis.

Only so that they look at once: the folder says what is true, and everybody looks there regularly as well.
"""

import contextlib
import secrets
from typing import Any

import redis.asyncio
import structlog
from redis.exceptions import RedisError

_log = structlog.get_logger(__name__)

_STREAM = "panoloc:changed"
_TIMEOUT_S = 0.5
# Of maps alone before there was word of batches; front doors of both versions may run beside each other.
_NAME = "map"
_MOST_KEPT = 1000
_LIFETIME_S = 60


class ChangeSignal:
    """Used from one event loop."""

    def __init__(self, url: str) -> None:
        self._redis = redis.asyncio.Redis.from_url(url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S)
        # Nobody needs to be told what he has done himself.
        self._own_name = secrets.token_hex(8)
        # The ids of a stream begin with the time, so that those after Redis was emptied are greater still.
        self._last_heard = "0-0"

    async def tell(self, name: str) -> None:
        """Say that a map or batch was changed, made or deleted, by its id; without Redis the others find it when they look."""
        with contextlib.suppress(RedisError, OSError):
            async with self._redis.pipeline(transaction=False) as pipe:
                pipe.xadd(_STREAM, {_NAME: name, "by": self._own_name}, maxlen=_MOST_KEPT, approximate=True)
                pipe.expire(_STREAM, _LIFETIME_S)
                await pipe.execute()

    async def heard(self) -> list[str]:
        """Return the maps and batches that other front doors have spoken of since the last call, at first those of the last minute."""
        try:
            found: Any = await self._redis.xrange(_STREAM, min=f"({self._last_heard}")
        except (RedisError, OSError) as error:
            _log.debug("Redis is away, what other front doors changed is found by looking", error=str(error))
            return []
        if found:
            self._last_heard = found[-1][0].decode()
        return [said[_NAME.encode()].decode() for _, said in found if said[b"by"].decode() != self._own_name]

    async def close(self) -> None:
        """Close the connections."""
        await self._redis.aclose()
