"""Rows with chosen errors, for tests of tables and fits."""

from typing import Any

from panoloc.core.decide.confidence import FEATURES
from panoloc.lab.evaluation.rows import Row


def made_row(number: int = 0, position_m: float | None = 0.01, orientation_deg: float = 0.1, **changes: Any) -> Row:
    """Return a localized row of the suite `rooms`; changes replace any of its fields."""
    values: dict[str, Any] = {
        "group": "rooms",
        "scan": f"rooms-{number}",
        "query": f"rooms-{number}/panorama",
        "method": "fast",
        "digest": "d",
        "cross": False,
        "status": "localized",
        "seconds": 1.0,
        "confidence": 0.9,
        "position_error_m": position_m,
        "orientation_error_deg": None if position_m is None else orientation_deg,
    }
    return Row(**(values | changes))


def searched(value: float, **measures: float) -> dict[str, Any]:
    """Return what confidence rests on, all of one value, but for some measures."""
    names = ("correlation", "patch_correlation", "explained", "relative_coverage", "coverage")
    features = dict.fromkeys(FEATURES, value)
    return {"measures": dict.fromkeys(names, value) | measures, "features": features, "score": value}
