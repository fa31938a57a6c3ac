"""The algorithm of panoloc: torch and numpy; no HTTP, no Redis, no logging set-up, no globals.

    >>> from core import Localizer, build_map_index, read_panorama, read_scan
    >>> index = build_map_index(read_scan(scan_path))
    >>> found = Localizer().localize(read_panorama(photo), [index])
    >>> found.status
    'localized'
    >>> found.best.pose.position.round(1)
    array([1.7, 2.4, 1.5])

Positions are metres in the scan's own frame (`core.geometry.pose`). What narrows a query is in `core.options`, what can go
wrong in `core.errors`; neither loads torch, and importing `core` loads nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from core.index.map_builder import build_map_index as build_map_index
    from core.localizer import Localizer as Localizer
    from core.options import Hints as Hints
    from core.panorama.reader import read_panorama as read_panorama
    from core.results import Localization as Localization
    from core.scan.reading import read_scan as read_scan

_HOMES = {
    "Hints": "core.options",
    "Localization": "core.results",
    "Localizer": "core.localizer",
    "build_map_index": "core.index.map_builder",
    "read_panorama": "core.panorama.reader",
    "read_scan": "core.scan.reading",
}
__all__ = ["Hints", "Localization", "Localizer", "build_map_index", "read_panorama", "read_scan"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for."""
    if name not in _HOMES:
        raise AttributeError(f"module 'core' has no attribute {name!r}; it offers {', '.join(__all__)}")
    return getattr(import_module(_HOMES[name]), name)
