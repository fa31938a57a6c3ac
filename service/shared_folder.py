"""What an API replica does because others use the same storage: see what they changed, take over what they leave."""

import asyncio
import contextlib
import math
import time
from dataclasses import dataclass, field

import structlog

from panoloc.service.batches.runs import BatchRuns
from panoloc.service.batches.store import BatchStore
from panoloc.service.errors import TryAgainError
from panoloc.service.maps.registrations import Registrations
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.sharing.change_signal import ChangeSignal
from panoloc.service.storage import Stamp, Storage

_log = structlog.get_logger(__name__)

LOOK_S = 0.5
"""Seconds after which a change is seen that no signal has published."""
_POLL_S = 0.1
# The work of a dead process is taken over after this, once its locks are free.
_TAKE_OVER_S = 0.5
# Results of a batch are published every moment.
_BATCHES_S = 1.0
_BATCH = "batch_"


@dataclass
class SharedFolder:
    """Used from one event loop. look_s: seconds between two looks at all that is stored."""

    storage: Storage
    registry: MapRegistry
    registrations: Registrations
    batches: BatchStore
    batch_runs: BatchRuns
    signal: ChangeSignal
    look_s: float
    _seen: dict[str, Stamp] = field(default_factory=dict, init=False)
    _published_batches: set[str] = field(default_factory=set, init=False)
    _done_s: dict[str, float] = field(default_factory=dict, init=False)
    _stopping: asyncio.Event = field(default_factory=asyncio.Event, init=False)
    _task: asyncio.Task[None] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.registry.publish = self.batches.publish = self.signal.publish

    def start(self) -> None:
        """Begin to poll and to look."""
        self._task = asyncio.create_task(self._run(), name="look at changes of other API replicas")

    async def stop(self) -> None:
        """Look no more, so that nothing new is taken over; changes are still published."""
        self._stopping.set()
        if self._task is not None:
            await asyncio.wait({self._task})

    async def close(self) -> None:
        """Close the connections, after the last change."""
        await self.signal.close()

    async def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                await self._poll()
                if self._is_due("batches", _BATCHES_S):
                    await self._look_at_published_batches()
                if self._is_due("look", self.look_s):
                    await self._look()
                if self._is_due("take over", _TAKE_OVER_S):
                    await self._take_over()
            except (TryAgainError, OSError) as error:
                _log.warning("changes of other API replicas cannot be read; the service retries", error=str(error))
            except Exception:
                _log.exception("polling for changes of other API replicas failed unexpectedly")
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), _POLL_S)

    def _is_due(self, what: str, every_s: float) -> bool:
        """Tell whether it is time for something again, once each time."""
        now_s = time.monotonic()
        if now_s - self._done_s.get(what, -math.inf) < every_s:
            return False
        self._done_s[what] = now_s
        return True

    async def _poll(self) -> None:
        changed = dict.fromkeys(await self.signal.poll())
        self._published_batches.update(each for each in changed if each.startswith(_BATCH))
        changed_maps = [each for each in changed if not each.startswith(_BATCH)]
        for map_id in changed_maps:
            await self.registry.refresh(map_id)
        if changed_maps:
            await self.registrations.end_unwanted()

    async def _look_at_published_batches(self) -> None:
        published, self._published_batches = self._published_batches, set()
        for batch_id in published:
            await self.batches.refresh_one(batch_id)

    async def _look(self) -> None:
        known = {record.id for record in self.registry.all()}
        stored = await asyncio.to_thread(self.storage.stamps, "maps", "map.json")
        # Also one that came and went since the last look, and was asked for in between.
        gone = known - stored.keys()
        new = {map_id for map_id, stamp in stored.items() if self._seen.get(map_id) != stamp}
        for map_id in [*gone, *(each for each in new if not self.registry.is_current(each, stored[each]))]:
            await self.registry.refresh(map_id)
        self._seen = stored
        await self.batches.refresh()

    async def _take_over(self) -> None:
        await self.registrations.end_unwanted()
        await self.batch_runs.end_unwanted()
        self.registrations.resume()
        self.batch_runs.resume()
