"""The last requests that ended in a problem, for whoever operates the service: what is asked next is always the request id."""

import json
from collections import deque
from typing import Any

from service.jobs import now
from service.problems import MEDIA_TYPE

MOST_ERRORS = 50
_MOST_BYTES = 8192
_KEPT = ("type", "title", "status", "detail", "request_id")


class RecentErrors:
    """The newest problems, with when and where they arose; of this process alone, and forgotten with it."""

    def __init__(self) -> None:
        self._errors: deque[dict[str, Any]] = deque(maxlen=MOST_ERRORS)

    def note(self, method: str, path: str, content_type: str, body: bytes) -> None:
        """Keep a response when it is a problem document."""
        # An answer may come in pieces; the last one may be empty.
        if content_type != MEDIA_TYPE or not body or len(body) > _MOST_BYTES:
            return
        document = json.loads(body)
        where = {"at": now(), "method": method, "path": path[:200]}
        self._errors.appendleft({**where, **{name: document.get(name) for name in _KEPT}})

    def newest(self) -> list[dict[str, Any]]:
        """Return them, newest first."""
        return list(self._errors)
