"""What a front door does because others use the same data folder: it sees what they changed, and takes over what they leave behind."""

import asyncio
import contextlib
import math
import time

import structlog

from service.batches.runs import BatchRuns
from service.batches.store import BatchStore
from service.errors import TryAgainError
from service.maps.registrations import Registrations
from service.maps.registry import MapRegistry
from service.sharing.change_signal import ChangeSignal
from service.storage import Stamp, Storage

_log = structlog.get_logger(__name__)

LOOK_S = 0.5
"""What a signal does not tell is seen after this."""
# What a dead process had under way is taken up after this, once its locks are free.
_TAKE_UP_S = 0.5
_LISTEN_S = 0.1
# Results of a batch come every moment.
_BATCHES_S = 1.0
_BATCH = "batch_"


class _Pace:
    """Says every so many seconds, and at once, that it is time."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._last_s = -math.inf

    def is_due(self) -> bool:
        """Tell whether it is time, once each time."""
        now_s = time.monotonic()
        if now_s - self._last_s < self._every_s:
            return False
        self._last_s = now_s
        return True


class SharedFolder:
    """Used from one event loop. look_s: seconds between two looks at all that is stored."""

    def __init__(
        self,
        storage: Storage,
        registry: MapRegistry,
        registrations: Registrations,
        batches: BatchStore,
        batch_runs: BatchRuns,
        signal: ChangeSignal,
        look_s: float = LOOK_S,
    ) -> None:
        self._storage = storage
        self._registry = registry
        self._registrations = registrations
        self._batches = batches
        self._batch_runs = batch_runs
        self._signal = signal
        self._look_s = look_s
        self._seen: dict[str, Stamp] = {}
        self._told_batches: set[str] = set()
        self._stopping = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        registry.call_on_change(signal.tell)
        batches.call_on_change(signal.tell)

    def start(self) -> None:
        """Begin to listen and to look."""
        self._task = asyncio.create_task(self._run(), name="look at what other front doors did")

    async def stop(self) -> None:
        """Look no more, so that nothing new is taken up; changes are still told."""
        self._stopping.set()
        if self._task is not None:
            await asyncio.wait({self._task})

    async def close(self) -> None:
        """Close the connections, after the last change."""
        await self._signal.close()

    async def _run(self) -> None:
        looking, taking_up, batches = _Pace(self._look_s), _Pace(_TAKE_UP_S), _Pace(_BATCHES_S)
        while not self._stopping.is_set():
            try:
                await self._listen()
                if batches.is_due():
                    await self._look_at_told_batches()
                if looking.is_due():
                    await self._look()
                if taking_up.is_due():
                    await self._take_up()
            except (TryAgainError, OSError) as error:
                _log.warning("what other front doors did cannot be seen, trying again", error=str(error))
            except Exception:
                _log.exception("looking at what other front doors did met an unexpected fault")
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), _LISTEN_S)

    async def _listen(self) -> None:
        changed = await self._signal.heard()
        self._told_batches.update(each for each in changed if each.startswith(_BATCH))
        changed_maps = [each for each in dict.fromkeys(changed) if not each.startswith(_BATCH)]
        for map_id in changed_maps:
            await self._registry.refresh(map_id)
        if changed_maps:
            await self._registrations.end_unwanted()

    async def _look_at_told_batches(self) -> None:
        told, self._told_batches = self._told_batches, set()
        for batch_id in told:
            await self._batches.refresh_one(batch_id)

    async def _look(self) -> None:
        known = {record.id for record in self._registry.all()}
        stored = await asyncio.to_thread(self._storage.stamps, "maps", "map.json")
        # Also one that came and went since the last look, and was asked for in between.
        gone = known - stored.keys()
        new = {map_id for map_id, stamp in stored.items() if self._seen.get(map_id) != stamp}
        for map_id in [*gone, *(each for each in new if not self._registry.is_current(each, stored[each]))]:
            await self._registry.refresh(map_id)
        self._seen = stored
        await self._batches.refresh()

    async def _take_up(self) -> None:
        await self._registrations.end_unwanted()
        await self._batch_runs.end_unwanted()
        self._registrations.resume()
        self._batch_runs.resume()
