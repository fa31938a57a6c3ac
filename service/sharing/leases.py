"""Locks of API replicas that share a bucket: leases in Redis, which end some seconds after their holder.

A process that stands still for longer may find that another has its lease. What must not happen twice does not rely on
leases alone: records of maps are only replaced as they were read, and deletions check first that a lease is sure.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable
from dataclasses import dataclass, field
from typing import TypeVar

import structlog
from redis.asyncio import Redis
from redis.asyncio.lock import Lock
from redis.exceptions import LockNotOwnedError, RedisError

from panoloc.service.errors import CacheDownError
from panoloc.service.sharing.locks import HeldLock, Locks

Answer = TypeVar("Answer")

_log = structlog.get_logger(__name__)

LEASE_S = 10.0
_PREFIX = "panoloc:lease:"
_TIMEOUT_S = 2.0


@dataclass(eq=False)
class _Lease:
    """renewed_s: monotonic, before the last request that renewed it was sent. is_lost: another process has it."""

    name: str
    in_redis: Lock
    renewed_s: float
    is_lost: bool = False
    released: asyncio.Event = field(default_factory=asyncio.Event)


class LeaseLocks(Locks):
    """lease_s: seconds for which a lease outlives its holder."""

    def __init__(self, url: str, lease_s: float = LEASE_S) -> None:
        self._redis: Redis = Redis.from_url(url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S)
        self._lease_s = lease_s
        self._held: dict[str, _Lease] = {}
        self._keeping: set[asyncio.Task[None]] = set()

    def is_sure(self, name: str) -> bool:
        """Tell whether a lease of this process is certainly still its own; True for one that it does not hold."""
        lease = self._held.get(name)
        return lease is None or not (lease.is_lost or time.monotonic() - lease.renewed_s > self._lease_s / 2)

    async def close(self) -> None:
        """Release everything and close the connections."""
        for lease in list(self._held.values()):
            self._release(lease)
        if self._keeping:
            await asyncio.wait(self._keeping)
        await self._redis.aclose()

    async def _try(self, name: str) -> HeldLock | None:
        if name in self._held:
            return None
        in_redis = Lock(self._redis, _PREFIX + name, timeout=self._lease_s, blocking=False, thread_local=False)
        lease = _Lease(name, in_redis, time.monotonic())
        if not await _answered(in_redis.acquire()):
            return None
        self._held[name] = lease
        lock = HeldLock(lambda: self._release(lease))
        keeping = asyncio.create_task(self._keep(lease, lock), name=f"keep the lease {name}")
        self._keeping.add(keeping)
        keeping.add_done_callback(self._keeping.discard)
        return lock

    def _release(self, lease: _Lease) -> None:
        if self._held.get(lease.name) is lease:
            del self._held[lease.name]
        lease.released.set()

    async def _keep(self, lease: _Lease, lock: HeldLock) -> None:
        """Renew a lease until it is released or lost, and delete it in the end."""
        while not lease.released.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(lease.released.wait(), self._lease_s / 5)
                break
            now_s = time.monotonic()
            try:
                if not await _answered(_renewed(lease.in_redis)):
                    lease.is_lost = True
                    _log.warning("another API replica has taken over", lease=lease.name)
                    lock.when_lost()
                    return
                lease.renewed_s = now_s
            except CacheDownError as error:
                # Nobody else gets one from a Redis that does not answer.
                _log.warning("a lease cannot be renewed; the service retries", lease=lease.name, error=str(error))
        with contextlib.suppress(RedisError, OSError):  # it ends by itself
            await lease.in_redis.release()


async def _renewed(lock: Lock) -> bool:
    """Renew a lock, also one that a Redis has lost which was restarted or needed room; False where another has it."""
    token = lock.local.token
    with contextlib.suppress(LockNotOwnedError):
        return bool(await lock.reacquire())
    return bool(await lock.acquire(token=token))


async def _answered(asked: Awaitable[Answer]) -> Answer:
    try:
        return await asked
    except (RedisError, OSError) as error:
        raise CacheDownError(
            f"expected a lock from Redis, got {error}; try again, or ask the operator to check Redis"
        ) from error
