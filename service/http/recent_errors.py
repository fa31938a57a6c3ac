"""The last requests that ended in a problem, for whoever operates the service: what is asked next is always the request id."""

import json
from collections import deque
from collections.abc import Iterable
from typing import Any

from service.jobs import now
from service.maps.record import MapRecord
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
        self._errors.appendleft(_entry(now(), method, path, json.loads(body)))

    def newest(self, failed: Iterable[MapRecord] = ()) -> list[dict[str, Any]]:
        """Return them, newest first.

        failed: maps that could not be built. Their uploads were accepted, so that no response told of it; they are listed
        among the others for as long as they are there.
        """
        of_maps = [_entry(each.updated_at, "POST", f"/maps/{each.id}", each.newest.error or {}) for each in failed]
        # Times of one form and one zone: their order is that of the text.
        return sorted([*self._errors, *of_maps], key=lambda entry: str(entry["at"]), reverse=True)[:MOST_ERRORS]


def _entry(at: str, method: str, path: str, document: dict[str, Any]) -> dict[str, Any]:
    return {"at": at, "method": method, "path": path[:200], **{name: document.get(name) for name in _KEPT}}
