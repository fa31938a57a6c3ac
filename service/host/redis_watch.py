"""Says in the log when Redis goes away and when it is back: requests only get 503, and nobody reads those of others."""

import asyncio
import logging
from urllib.parse import urlsplit

from panoloc.service.cache import Cache
from panoloc.service.errors import CacheDownError

_log = logging.getLogger(__name__)

_INTERVAL_S = 10.0
_AWAY = "Redis does not answer or stores nothing; requests get 503, or their answers are not stored"


async def watch_redis(cache: Cache, url: str, interval_s: float = _INTERVAL_S) -> None:
    """Look every `interval_s` whether the Redis at `url` answers, until cancelled; log changes, and its absence at the start."""
    parts, was_up = urlsplit(url), True
    # Without the password that a URL may hold.
    place = {"redis": f"{parts.hostname}:{parts.port or 6379}" if parts.hostname else parts.path}
    while True:
        try:
            await cache.check_writable()
            if not was_up:
                _log.info("Redis answers again", extra=place)
            was_up = True
        except CacheDownError as error:
            if was_up:
                _log.warning(_AWAY, extra=place | {"error": str(error)})
            was_up = False
        await asyncio.sleep(interval_s)
