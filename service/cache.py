"""What lives in Redis, all of it with a lifetime: nothing here is lost for good when Redis is.

    index:{map}:{revision}:{digest}     encoded map index               written by workers, kept while it is used
    progress:{map}:{revision}           what a registration is at       written by workers
    localization:{id}                   state, then answer              written by the HTTP process
    picture:{id}:{name}                 PNG                             written by the HTTP process
    of_map:{map}                        ids of the answers about a map  deleted with the map
    once:{digest}                       answer of an Idempotency-Key    written by the HTTP process
    rate/{limit}/{caller}/…             what callers asked for          written by `panoloc.service.limits.caller_rates`

`Cache` is the asynchronous side, for the HTTP process; `WorkerCache` the blocking side, for workers. Both connect when
they are first used, connect again by themselves after Redis was away, and raise CacheDownError while it is.

Answers of Redis are annotated `Any` where redis-py leaves open whether they are text: we never ask it to decode them.
"""

import asyncio
import json
import time
from collections.abc import AsyncIterator, Iterable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Any

import redis
import redis.asyncio
from redis.asyncio.retry import Retry as AsyncRetry
from redis.backoff import ExponentialBackoff
from redis.exceptions import BusyLoadingError, OutOfMemoryError, ReadOnlyError
from redis.retry import Retry

from panoloc.service.errors import CacheDownError
from panoloc.service.jobs import ARTIFACTS, MapRef

_TIMEOUT_S = 5.0
_RETRIES = 3
_MOST_S = 10.0  # that the HTTP process waits in all, retries included: a server that hangs refuses no connection
_MOST_OF_CHECK_S = 4.0  # less than those wait who ask whether the service is ready
_PROBE_S = 10
_PROGRESS_LIFETIME_S = 600
_ONCE_UNDER_WAY_S = 3600  # after which a request whose process is gone may be done again
_RETRY_AFTER_S = 2
# A server that loads its data, is full, or is only a replica for now is as good as away.
_TEMPORARY = (BusyLoadingError, OutOfMemoryError, ReadOnlyError)
_LOST = (redis.ConnectionError, redis.TimeoutError, *_TEMPORARY, OSError)


class WorkerCache:
    """The side of the workers. Safe for several threads."""

    def __init__(self, url: str, *, index_lifetime_s: int) -> None:
        backoff = ExponentialBackoff(cap=0.2, base=0.02)
        self._redis = redis.Redis.from_url(
            url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S, retry=Retry(backoff, _RETRIES)
        )
        self._index_lifetime_s = index_lifetime_s

    def get_index(self, ref: MapRef, digest: str) -> bytes | None:
        """Return the encoded index, None when it is not there; reading it renews its lifetime."""
        with _down_is_said():
            try:
                found: Any = self._redis.getex(_index_key(ref, digest), ex=self._index_lifetime_s)
            except ReadOnlyError:
                # A replica that waits to become the first still knows the index.
                found = self._redis.get(_index_key(ref, digest))
            return None if found is None else bytes(found)

    def put_index(self, ref: MapRef, digest: str, data: bytes) -> None:
        """Store an encoded index; digest: of the configuration that it was built with, hexadecimal."""
        with _down_is_said():
            self._redis.set(_index_key(ref, digest), data, ex=self._index_lifetime_s)

    def forget_index(self, ref: MapRef, digest: str) -> None:
        """Delete one encoded index."""
        with _down_is_said():
            self._redis.unlink(_index_key(ref, digest))

    def report_progress(self, ref: MapRef, status: str, stage: str, progress: float) -> None:
        """Tell what a registration is at: status "reading" or "indexing", stage in words, progress 0..1 of all."""
        value = json.dumps({"status": status, "stage": stage, "progress": round(progress, 3)})
        with _down_is_said():
            self._redis.set(_progress_key(ref), value, ex=_PROGRESS_LIFETIME_S)

    def close(self) -> None:
        """Close the connections."""
        self._redis.close()


class Cache:
    """The side of the HTTP process. Used from one event loop."""

    def __init__(self, url: str, *, result_lifetime_s: int) -> None:
        backoff = ExponentialBackoff(cap=0.2, base=0.02)
        self._redis = redis.asyncio.Redis.from_url(
            url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S, retry=AsyncRetry(backoff, _RETRIES)
        )
        self._result_lifetime_s = result_lifetime_s

    async def check(self) -> None:
        """Raise CacheDownError unless Redis answers."""
        async with _down_is_said_async():
            await self._redis.ping()

    async def check_writable(self) -> None:
        """Raise CacheDownError unless Redis takes a value: one that is full or read-only answers, but keeps nothing."""
        # In one transaction, so that nobody ever meets the key.
        async with _down_is_said_async(_MOST_OF_CHECK_S), self._redis.pipeline(transaction=True) as pipe:
            pipe.set("probe", b"", ex=_PROBE_S)
            pipe.unlink("probe")
            await pipe.execute()

    async def get_progress(self, refs: Iterable[MapRef]) -> dict[MapRef, dict[str, Any]]:
        """Return what the registrations of `refs` are at; those that have not begun are left out."""
        wanted = list(refs)
        if not wanted:
            return {}
        async with _down_is_said_async():
            found = await self._redis.mget([_progress_key(ref) for ref in wanted])
        return {ref: json.loads(value) for ref, value in zip(wanted, found, strict=True) if value is not None}

    async def put_state(self, localization_id: str, state: Mapping[str, Any], extra_s: float = 0.0) -> None:
        """Store the state of a localization; extra_s: seconds for which it is kept beyond the lifetime of an answer."""
        async with _down_is_said_async():
            lifetime_s = self._result_lifetime_s + int(extra_s)
            await self._redis.set(_localization_key(localization_id), _json(state), ex=lifetime_s)

    async def put_answer(
        self, localization_id: str, body: Mapping[str, Any], pictures: Mapping[str, bytes], map_ids: Iterable[str]
    ) -> None:
        """Store an answer with its PNGs by name; map_ids: the maps with which it is deleted."""
        lifetime_s, now = self._result_lifetime_s, time.time()
        async with _down_is_said_async(), self._redis.pipeline(transaction=False) as pipe:
            for name, data in pictures.items():
                pipe.set(_picture_key(localization_id, name), data, ex=lifetime_s)
            pipe.set(_localization_key(localization_id), _json(body), ex=lifetime_s)
            for map_id in map_ids:
                pipe.zremrangebyscore(f"of_map:{map_id}", "-inf", now)
                pipe.zadd(f"of_map:{map_id}", {localization_id: now + lifetime_s})
                pipe.expire(f"of_map:{map_id}", lifetime_s)
            await pipe.execute()

    async def get_localization(self, localization_id: str) -> dict[str, Any] | None:
        """Return what was stored last, None when there is nothing (any more)."""
        async with _down_is_said_async():
            found = await self._redis.get(_localization_key(localization_id))
        return None if found is None else dict(json.loads(found))

    async def get_picture(self, localization_id: str, name: str) -> bytes | None:
        """Return one PNG, None when there is none (any more)."""
        async with _down_is_said_async():
            found: Any = await self._redis.get(_picture_key(localization_id, name))
        return None if found is None else bytes(found)

    async def forget_localization(self, localization_id: str) -> bool:
        """Delete an answer or its state, and its pictures; return whether there was one."""
        keys = [_picture_key(localization_id, name) for name in ARTIFACTS]
        async with _down_is_said_async():
            found: Any = await self._redis.delete(_localization_key(localization_id))
            await self._redis.unlink(*keys)
        return bool(found)

    async def begin_once(self, name: str) -> dict[str, Any] | None:
        """Note that a request begins that shall be done once; return what was noted of it before, None for nothing."""
        async with _down_is_said_async():
            found: Any = await self._redis.set(_once_key(name), _json({}), ex=_ONCE_UNDER_WAY_S, nx=True, get=True)
        return None if found is None else dict(json.loads(found))

    async def end_once(self, name: str, answer: Mapping[str, Any] | None) -> None:
        """Keep the answer to such a request; None: it may be done again."""
        with suppress(CacheDownError):  # the answer is sent all the same
            async with _down_is_said_async():
                if answer is None:
                    await self._redis.unlink(_once_key(name))
                else:
                    await self._redis.set(_once_key(name), _json(answer), ex=self._result_lifetime_s)

    async def forget_revision(self, ref: MapRef) -> None:
        """Delete index and progress of one revision."""
        async with _down_is_said_async():
            await self._redis.unlink(_progress_key(ref), *await self._keys(f"index:{ref.id}:{ref.revision}:*"))

    async def forget_map(self, map_id: str) -> None:
        """Delete indexes, progress, answers and pictures of one map."""
        async with _down_is_said_async():
            members: Any = await self._redis.zrange(f"of_map:{map_id}", 0, -1)
            answers = [
                key
                for each in map(bytes.decode, members)
                for key in (_localization_key(each), *(_picture_key(each, name) for name in ARTIFACTS))
            ]
            # Of the map itself: its indexes and what its registrations are at.
            own = await self._keys(f"*:{map_id}:*")
            await self._redis.unlink(f"of_map:{map_id}", *answers, *own)

    async def close(self) -> None:
        """Close the connections."""
        await self._redis.aclose()

    async def _keys(self, pattern: str) -> list[bytes]:
        return [key async for key in self._redis.scan_iter(match=pattern, count=1000)]


def _index_key(ref: MapRef, digest: str) -> str:
    return f"index:{ref.id}:{ref.revision}:{digest}"


def _progress_key(ref: MapRef) -> str:
    return f"progress:{ref.id}:{ref.revision}"


def _localization_key(localization_id: str) -> str:
    return f"localization:{localization_id}"


def _once_key(name: str) -> str:
    return f"once:{name}"


def _picture_key(localization_id: str, name: str) -> str:
    return f"picture:{localization_id}:{name}"


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, allow_nan=False)


@contextmanager
def _down_is_said() -> Iterator[None]:
    try:
        yield
    except _LOST as error:
        raise CacheDownError(
            f"expected an answer from Redis, got {type(error).__name__}; the service reconnects by itself; try again",
            _RETRY_AFTER_S,
        ) from error


@asynccontextmanager
async def _down_is_said_async(most_s: float = _MOST_S) -> AsyncIterator[None]:
    task = asyncio.current_task()
    cancelled_before = task.cancelling() if task else 0
    try:
        with _down_is_said():
            async with asyncio.timeout(most_s):
                yield
    finally:
        # redis-py waits with `asyncio.wait_for`, which in Python 3.11 forgets a cancellation that comes together
        # with the answer: the task would go on as if nobody had ended it.
        if task and task.cancelling() > cancelled_before:
            raise asyncio.CancelledError
