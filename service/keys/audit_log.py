"""Who changed what, and when: one JSON object a line, in a file that is only ever appended to."""

import fcntl
import json
import logging
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

NAME = "audit.jsonl"

Change = Literal[
    "map registered", "map changed", "scan replaced", "map deleted", "batch made", "batch renamed",
    "batch deleted", "photo placed",
    "key made", "key revoked",
]  # fmt: skip

_log = logging.getLogger(__name__)


class AuditLog:
    """Blocking, for the microseconds that a line takes; may be used by several processes at once."""

    def __init__(self, data_dir: Path) -> None:
        self.path = data_dir / NAME

    def note(self, who: str, change: Change, what: str, request_id: str | None = None) -> None:
        """Write a line. who: the id of a caller, or who used the command line. what: the id of a map, batch or key.

        A line that cannot be written, as on a full disk, goes to the log of the service: the change has been made.
        """
        at = datetime.now(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")
        line = {"at": at, "who": who, "change": change, "what": what, "request_id": request_id}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
            try:
                # Several API replicas may share the folder, on a file system that appends for one machine at a time.
                fcntl.flock(file, fcntl.LOCK_EX)
                os.write(file, (json.dumps(line) + "\n").encode())
            finally:
                os.close(file)
        except OSError as error:
            _log.error("a line of the audit log cannot be written", extra={**line, "error": str(error)})
