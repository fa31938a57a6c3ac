"""The files of the demo room, made once by a process of their own, which needs numpy and a ray caster, and kept in storage."""

import asyncio
import contextlib
import shutil
import sys
from pathlib import Path

from panoloc.service.errors import StoredFileMissingError, WorkerError
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
        """Return one of DEMO_FILES; the first time that takes as long as the room takes to be made. Raises StorageError and WorkerError."""
        async with self._making:
            with contextlib.suppress(StoredFileMissingError):
                return await asyncio.to_thread(self._storage.read, _key(name))
            await self._make()
        return await asyncio.to_thread(self._storage.read, _key(name))

    async def _make(self) -> None:
        folder = await asyncio.to_thread(self._storage.spool_folder) / new_id("demo")
        folder.mkdir()
        try:
            await _run(folder)
            for each in DEMO_FILES:
                await asyncio.to_thread(self._storage.put, _key(each), (folder / each).read_bytes())
        finally:
            await asyncio.to_thread(shutil.rmtree, folder, True)


async def _run(folder: Path) -> None:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-P",
        "-m",
        _MAKER,
        str(folder),
        stderr=asyncio.subprocess.PIPE,
        stdin=asyncio.subprocess.DEVNULL,
    )
    try:
        _, said = await process.communicate()
    except BaseException:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        raise
    if process.returncode != 0:
        last = (said.decode(errors="replace").strip().splitlines() or ["it printed nothing"])[-1]
        raise WorkerError(
            "DemoRoom", f"the process that generates the demo room ended with exit code {process.returncode}: {last}"
        )


def _key(name: str) -> str:
    return f"demo/{name}"
