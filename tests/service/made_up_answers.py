"""Answers for tests that need no algorithm."""

from typing import Any

from panoloc.service.answer import Change, Localization


def empty_answer(**changes: Any) -> Localization:
    """Return the answer of a search that found nothing, with other fields as they are given."""
    nothing: dict[str, Any] = dict.fromkeys(
        ("map_id", "map_revision", "pose", "map_from_session", "geopose", "accuracy")
    )
    nothing |= {"id": "loc_1", "status": "not_localized", "confidence": 0.0}
    nothing |= {name: {} for name in ("artifacts", "timings_s", "search")}
    nothing |= {name: [] for name in ("images", "alternatives", "warnings")}
    change = Change(panorama_changed_fraction=None, map_changed_fraction=None)
    return Localization(**{**nothing, "change": change, **changes})
