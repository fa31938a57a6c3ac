"""The last requests that ended in a problem, for operators: callers report a request id, and this list says what it was
about."""

import json
from collections import deque
from collections.abc import Iterable
from typing import Any

from panoloc.service.jobs import now
from panoloc.service.maps.record import MapRecord
from panoloc.service.problems import MEDIA_TYPE

_MOST_ERRORS = 50
_MOST_BYTES = 8192
_KEPT = ("type", "title", "status", "detail", "request_id")


class RecentErrors:
    """The newest problems of this process, with their time and request."""

    def __init__(self) -> None:
        self._errors: deque[dict[str, Any]] = deque(maxlen=_MOST_ERRORS)

    def note(self, method: str, path: str, content_type: str, body: bytes) -> None:
        """Keep a response when it is a problem document."""
        # The last piece of an answer may be empty.
        if content_type != MEDIA_TYPE or not body or len(body) > _MOST_BYTES:
            return
        self._errors.appendleft(_entry(now(), method, path, json.loads(body)))

    def newest(self, failed: Iterable[MapRecord] = ()) -> list[dict[str, Any]]:
        """Return them, newest first.

        failed: maps that could not be built. Their uploads were accepted, so no response reported the failure; they are
        listed as long as they exist.
        """
        of_maps = [_entry(each.updated_at, "POST", f"/maps/{each.id}", each.newest.error or {}) for each in failed]
        # All times have one format and one zone, so that their order is that of the text.
        return sorted([*self._errors, *of_maps], key=lambda entry: str(entry["at"]), reverse=True)[:_MOST_ERRORS]


def _entry(at: str, method: str, path: str, document: dict[str, Any]) -> dict[str, Any]:
    return {"at": at, "method": method, "path": path[:200], **{name: document.get(name) for name in _KEPT}}
