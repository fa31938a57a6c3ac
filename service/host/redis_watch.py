"""Says in the log when Redis goes away and when it is back: requests only get 503, and nobody reads those of others."""

import asyncio
import logging
from urllib.parse import urlsplit

from panoloc.service.cache import Cache
from panoloc.service.errors import CacheDownError

_log = logging.getLogger(__name__)

_INTERVAL_S = 10.0


async def watch_redis(cache: Cache, url: str, interval_s: float = _INTERVAL_S) -> None:
    """Look every `interval_s` whether the Redis at `url` answers, until cancelled; log changes, and its absence at the start."""
    was_up = True
    while True:
        try:
            await cache.check_writable()
            is_up = True
        except CacheDownError as error:
            is_up = False
            if was_up:
                said = {"redis": _place(url), "error": str(error)}
                _log.warning(
                    "Redis does not answer or stores nothing; requests get 503, or their answers are not stored",
                    extra=said,
                )
        if is_up and not was_up:
            _log.info("Redis answers again", extra={"redis": _place(url)})
        was_up = is_up
        await asyncio.sleep(interval_s)


def _place(url: str) -> str:
    """Return where a URL points, without the password that it may hold."""
    parts = urlsplit(url)
    return f"{parts.hostname}:{parts.port or 6379}" if parts.hostname else parts.path
