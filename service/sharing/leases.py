"""Locks of front doors that share nothing but a bucket and Redis: leases, which end some seconds after whoever holds them.

A lease is a key in Redis with a lifetime and the token of its holder, who renews it. A process that stands still for longer than the
lifetime may find that another has its lease. What must not happen twice does not rely on it alone: records of maps are only replaced as
they were read, and deletions look first whether a lease is sure.
"""

import asyncio
import contextlib
import secrets
import time
from collections.abc import Awaitable
from dataclasses import dataclass
from typing import Any, TypeVar

import redis.asyncio
import structlog
from redis.exceptions import RedisError

from service.errors import CacheDownError
from service.sharing.held_lock import HeldLock, held_once_free, unless_cancelled

Answer = TypeVar("Answer")

_log = structlog.get_logger(__name__)

LEASE_S = 10.0
_PREFIX = "panoloc:lease:"
_TIMEOUT_S = 2.0
# Ours again where nobody has it: a Redis that was started anew, or needed room, has lost all leases.
_RENEW = """
local holder = redis.call('get', KEYS[1])
if holder == false or holder == ARGV[1] then
  redis.call('set', KEYS[1], ARGV[1], 'PX', ARGV[2])
  return 1
end
return 0
"""
_LET_GO = "if redis.call('get', KEYS[1]) == ARGV[1] then return redis.call('del', KEYS[1]) end return 0"


@dataclass(eq=False)
class _Lease:
    """renewed_s: monotonic, before the last request that renewed it was sent. is_lost: another has it."""

    name: str
    token: str
    renewed_s: float
    lock: HeldLock
    is_lost: bool = False


class LeaseLocks:
    """Implements `FolderLocks`. lease_s: seconds for which a lease outlives its holder."""

    is_shared = True

    def __init__(self, url: str, lease_s: float = LEASE_S) -> None:
        self._redis = redis.asyncio.Redis.from_url(url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S)
        self._lease_s = lease_s
        self._held: dict[str, _Lease] = {}
        self._renewing: asyncio.Task[None] | None = None
        self._letting_go: set[asyncio.Task[None]] = set()

    async def try_hold(self, name: str) -> HeldLock | None:
        """Return the lock, None while somebody else holds it. Raises CacheDownError."""
        return await unless_cancelled(self._try(name))

    def held(self, name: str) -> contextlib.AbstractAsyncContextManager[None]:
        """Wait for a lock and hold it for the duration of a block. Raises CacheDownError."""
        return held_once_free(self.try_hold, name)

    def is_sure(self, name: str) -> bool:
        """Tell whether a lock that this process holds is still its own beyond doubt; True for one that it does not hold."""
        lease = self._held.get(name)
        return lease is None or not (lease.is_lost or self._age_s(lease) > self._lease_s / 2)

    async def close(self) -> None:
        """Let go of everything and close the connections."""
        for lease in list(self._held.values()):
            lease.lock.release()
        if self._letting_go:
            await asyncio.wait(self._letting_go)
        if self._renewing is not None:
            self._renewing.cancel()
            await asyncio.wait({self._renewing})
        await self._redis.aclose()

    async def _try(self, name: str) -> HeldLock | None:
        if name in self._held:
            return None
        token, now_s = secrets.token_hex(16), time.monotonic()
        lifetime_ms = int(self._lease_s * 1000)
        if not await _answered(self._redis.set(_PREFIX + name, token, nx=True, px=lifetime_ms)):
            return None
        lock = HeldLock(lambda: self._let_go(lease))
        lease = self._held[name] = _Lease(name, token, now_s, lock)
        if self._renewing is None or self._renewing.done():
            self._renewing = asyncio.create_task(self._renew_all(), name="renew leases")
        return lock

    async def _renew_all(self) -> None:
        while self._held:
            await asyncio.sleep(self._lease_s / 5)
            try:
                await asyncio.gather(*(self._renew(lease) for lease in list(self._held.values()) if not lease.is_lost))
            except CacheDownError as error:
                # Nobody else gets one from a Redis that is away.
                _log.warning("leases cannot be renewed, trying again", error=str(error))

    async def _renew(self, lease: _Lease) -> None:
        now_s = time.monotonic()
        renewed: Any = self._redis.eval(_RENEW, 1, _PREFIX + lease.name, lease.token, str(int(self._lease_s * 1000)))
        if await _answered(renewed):
            lease.renewed_s = now_s
            if self._held.get(lease.name) is not lease:  # let go meanwhile, and perhaps before this
                self._begin_to_let_go(lease)
        elif self._held.get(lease.name) is lease:
            lease.is_lost = True
            _log.warning(
                "another front door has taken over", lease=lease.name, not_renewed_s=round(self._age_s(lease), 1)
            )
            lease.lock.lose()

    def _let_go(self, lease: _Lease) -> None:
        if self._held.get(lease.name) is lease:
            del self._held[lease.name]
            if not lease.is_lost:
                self._begin_to_let_go(lease)

    def _begin_to_let_go(self, lease: _Lease) -> None:
        task = asyncio.create_task(self._delete(lease), name=f"let go of {lease.name}")
        self._letting_go.add(task)
        task.add_done_callback(self._letting_go.discard)

    async def _delete(self, lease: _Lease) -> None:
        deleted: Any = self._redis.eval(_LET_GO, 1, _PREFIX + lease.name, lease.token)
        with contextlib.suppress(CacheDownError):  # it ends by itself
            await _answered(deleted)

    def _age_s(self, lease: _Lease) -> float:
        return time.monotonic() - lease.renewed_s


async def _answered(asked: Awaitable[Answer]) -> Answer:
    try:
        return await asked
    except (RedisError, OSError) as error:
        raise CacheDownError(
            f"expected a lock from Redis, got {error}; try again, or let the operator look at Redis"
        ) from error
