"""A map as the HTTP contract shows it."""

from typing import Any

from service.maps.record import MapRecord


def map_document(record: MapRecord, progress: dict[str, Any] | None) -> dict[str, Any]:
    """Return the JSON of a map; progress: what its registration reported last, None when it has not begun."""
    newest, serving = record.newest, record.serving
    shown = newest if newest.status == "ready" or serving is None else serving
    return {
        "id": record.id,
        "name": record.name,
        "tags": record.tags,
        "revision": newest.number,
        "serving_revision": None if serving is None else serving.number,
        **_state(newest.status, progress),
        "error": newest.error,
        "created_at": record.created_at,
        "updated_at": record.updated_at,
        "stats": shown.stats,
        "diagnostics": shown.diagnostics,
        "georeference": record.georeference,
    }


def _state(status: str, progress: dict[str, Any] | None) -> dict[str, Any]:
    if status != "queued":
        return {"status": status, "stage": None, "progress": 1.0 if status == "ready" else 0.0}
    if progress is None:
        return {"status": "queued", "stage": "waiting for a worker", "progress": 0.0}
    return {"status": progress["status"], "stage": progress["stage"], "progress": progress["progress"]}
