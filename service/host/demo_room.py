"""The files of the demo room, made once by a process of their own, which needs numpy and a ray caster, and kept in storage."""

import asyncio
import contextlib
import shutil

from panoloc.service.errors import StoredFileMissingError, WorkerError
from panoloc.service.host.child_processes import run_module
from panoloc.service.jobs import new_id
from panoloc.service.storage import Storage

DEMO_FILES = ("room.ply", "panorama.jpg")
# Of another package, which the service does not import; it comes with the same installation.
_MAKER = "panoloc.lab.demo_room"


class DemoRoom:
    """Used from one event loop."""

    def __init__(self, storage: Storage) -> None:
        self._storage = storage
        self._making = asyncio.Lock()

    async def file(self, name: str) -> bytes:
        """Return one of DEMO_FILES, which the first call makes in some seconds. Raises StorageError and WorkerError."""
        async with self._making:
            with contextlib.suppress(StoredFileMissingError):
                return await asyncio.to_thread(self._storage.read, f"demo/{name}")
            await self._make()
        return await asyncio.to_thread(self._storage.read, f"demo/{name}")

    async def _make(self) -> None:
        folder = await asyncio.to_thread(self._storage.spool_folder) / new_id("demo")
        folder.mkdir()
        try:
            code, message = await run_module(_MAKER, str(folder))
            if code != 0:
                raise WorkerError("DemoRoom", f"the process of the demo room ended with exit code {code}: {message}")
            for each in DEMO_FILES:
                await asyncio.to_thread(self._storage.put, f"demo/{each}", (folder / each).read_bytes())
        finally:
            await asyncio.to_thread(shutil.rmtree, folder, True)
