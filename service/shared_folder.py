"""What a front door does because others use the same data folder: it sees what they changed, and takes over what they leave behind."""

import asyncio
import contextlib
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

# What a signal does not tell is seen after this; what a dead process had under way is taken up after it.
_LOOK_S = 0.5
_LISTEN_S = 0.1


class SharedFolder:
    """Used from one event loop."""

    def __init__(
        self,
        storage: Storage,
        registry: MapRegistry,
        registrations: Registrations,
        batches: BatchStore,
        batch_runs: BatchRuns,
        signal: ChangeSignal,
    ) -> None:
        self._storage = storage
        self._registry = registry
        self._registrations = registrations
        self._batches = batches
        self._batch_runs = batch_runs
        self._signal = signal
        self._seen: dict[str, Stamp] = {}
        self._stopping = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        registry.call_on_change(signal.tell)

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
        looked_s = -_LOOK_S
        while not self._stopping.is_set():
            try:
                await self._listen()
                if time.monotonic() - looked_s >= _LOOK_S:
                    looked_s = time.monotonic()
                    await self._look()
            except (TryAgainError, OSError) as error:
                _log.warning("what other front doors did cannot be seen, trying again", error=str(error))
            except Exception:
                _log.exception("looking at what other front doors did met an unexpected fault")
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._stopping.wait(), _LISTEN_S)

    async def _listen(self) -> None:
        changed = await self._signal.heard()
        for map_id in dict.fromkeys(changed):
            await self._registry.refresh(map_id)
        if changed:
            await self._registrations.end_unwanted()

    async def _look(self) -> None:
        known = {record.id for record in self._registry.all()}
        stored = await asyncio.to_thread(self._storage.stamps, "maps", "map.json")
        # Also one that came and went since the last look, and was asked for in between.
        gone = known - stored.keys()
        for map_id in [*gone, *(map_id for map_id, stamp in stored.items() if self._seen.get(map_id) != stamp)]:
            await self._registry.refresh(map_id)
        self._seen = stored
        await self._batches.refresh()
        await self._registrations.end_unwanted()
        await self._batch_runs.end_unwanted()
        self._registrations.resume()
        self._batch_runs.resume()
