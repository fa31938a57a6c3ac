"""One registration or rebuild in a process of its own, so that queries come first and the memory is returned at the end."""

import asyncio
from typing import Any

from panoloc.service.pool.messages import Hello, Kind
from panoloc.service.pool.worker_process import Work, WorkerProcess
from panoloc.service.worker.reply import WorkerReply


async def run_build(hello: Hello, kind: Kind, job: Any) -> WorkerReply[Any]:
    """Run one build; cancelling the call ends its process. Raises NoWorkerError when the process dies."""
    work = Work(0, kind, job)
    process = WorkerProcess("panoloc.service.pool.child builder", hello, on_loss=_note_loss)
    process.begin(work)
    running = asyncio.create_task(process.run())
    try:
        return await work.future
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def _note_loss(work: Work, how: str) -> None:
    work.fail(f"the process that builds the map ended ({how}); the memory may be too small for this scan")
