"""From the JSON options of a job, already validated by the HTTP side, to what `core` takes."""

from pathlib import PurePosixPath
from typing import Any

from core.index.map_index import IndexOptions
from core.results import Hints
from core.scan import ScanOptions

Options = dict[str, Any]


def hints_of(options: Options) -> Hints | None:
    """Return the hints of a localization, None when there are none."""
    given = {name: value for name, value in (options.get("hints") or {}).items() if value is not None}
    if not given:
        return None
    if "position_m" in given:
        given["position_m"] = tuple(given["position_m"])
    if "region" in given:
        given["region"] = _box(given["region"])
    return Hints(**given)


def scan_options_of(options: Options, scan_name: str, max_points: int, max_points_used: int) -> ScanOptions:
    """Return how to read the scan that was uploaded as `scan_name`."""
    return ScanOptions(
        unit=options.get("unit", "m"),
        up_axis=options.get("up_axis", "z"),
        color_kind=options.get("color_kind", "rgb"),
        max_points=max_points_used,
        max_points_read=max_points,
        format=PurePosixPath(scan_name).suffix.lstrip(".").lower() or None,
    )


def index_options_of(options: Options) -> IndexOptions:
    """Return how to build the index of a map."""
    starts = options.get("starts") or {}
    region = starts.get("region")
    return IndexOptions(
        starts_method=starts.get("method", "octree"),
        spacing_m=starts.get("spacing_m"),
        region=_box(region) if region else None,
        color_kind=options.get("color_kind", "rgb"),
    )


def _box(region: dict[str, Any]) -> Any:
    return tuple(region["min"]), tuple(region["max"])
