"""Files that modules of this installation write in processes of their own, because they compute and open files of strangers."""

import asyncio
import json
import os
from typing import Any, BinaryIO

import structlog

from panoloc.core.errors import ExportRefusedError
from panoloc.service.errors import ExportFailedError
from panoloc.service.host.child_processes import run_module
from panoloc.service.jobs import new_id
from panoloc.service.storage import Storage

_log = structlog.get_logger(__name__)

LONGEST_S = 600.0
_REFUSED = 3  # exit code for what cannot be written as was asked for


async def written_file(
    storage: Storage, module: str, document: dict[str, Any], *options: str, suffix: str = ""
) -> BinaryIO:
    """Return what `python -m MODULE DOCUMENT OPTION... TARGET` writes, open and without a name, so that nothing is left of it once closed.

    Raises ExportRefusedError, ExportFailedError and StorageError.
    """
    folder = await asyncio.to_thread(storage.spool_folder)
    source, target = folder / new_id("document"), folder / f"{new_id('written')}{suffix}"
    # It opens photos and scans of strangers, and needs no token of Ray for that.
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("RAY_", "PANOLOC_"))}
    try:
        await asyncio.to_thread(source.write_text, json.dumps(document), encoding="utf-8")
        code, message = await run_module(
            module, str(source), *options, str(target), environment=environment, time_s=LONGEST_S
        )
        if code == _REFUSED:
            raise ExportRefusedError(message)
        if code != 0:
            # Its message may name folders of this machine, which callers are not told.
            _log.error("a process that writes a file failed", module=module, exit_code=code, error=message)
            raise ExportFailedError("the process that writes the file failed; report it with the request id")
        return target.open("rb")
    except TimeoutError as error:
        raise ExportFailedError(f"expected a file within {LONGEST_S:g} s, got none; ask for fewer photos") from error
    finally:
        for path in (source, target):
            path.unlink(missing_ok=True)
