"""Find where a photo was taken inside a scanned place.

    >>> from panoloc import Localizer, Rig, build_map_index, read_panorama, read_scan
    >>> index = build_map_index(read_scan(scan_path))
    >>> found = Localizer().localize(Rig.of_panorama(read_panorama(photo_bytes)), [index])
    >>> found.status
    'localized'
    >>> found.best.pose.position.round(1)
    array([1.7, 2.4, 1.5])

Positions are metres in the scan's own frame (`panoloc.core.geometry.pose`). `PanolocClient` speaks to a running
service; its maps are `Map`, and its answers `Localized`, `Ambiguous` or `NotLocalized`. `panoloc.core.errors` lists what
can go wrong. A name loads its module when it is first used: importing `panoloc` loads nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from panoloc.core.camera.rig import Rig as Rig
    from panoloc.core.image.reader import read_panorama as read_panorama
    from panoloc.core.localizer import Localizer as Localizer
    from panoloc.core.map.map_builder import build_map_index as build_map_index
    from panoloc.core.options import Hints as Hints
    from panoloc.core.results import Localization as Localization
    from panoloc.core.scan.reading import read_scan as read_scan
    from panoloc.service.answer import Ambiguous as Ambiguous
    from panoloc.service.answer import Localized as Localized
    from panoloc.service.answer import NotLocalized as NotLocalized
    from panoloc.service.client.typed_client import Answer as Answer
    from panoloc.service.client.typed_client import PanolocClient as PanolocClient
    from panoloc.service.http.schemas.known_map import Map as Map

    __version__: str

_HOMES = {
    "Ambiguous": "panoloc.service.answer",
    "Answer": "panoloc.service.client.typed_client",
    "Hints": "panoloc.core.options",
    "Localization": "panoloc.core.results",
    "Localized": "panoloc.service.answer",
    "Localizer": "panoloc.core.localizer",
    "Map": "panoloc.service.http.schemas.known_map",
    "NotLocalized": "panoloc.service.answer",
    "PanolocClient": "panoloc.service.client.typed_client",
    "Rig": "panoloc.core.camera.rig",
    "build_map_index": "panoloc.core.map.map_builder",
    "read_panorama": "panoloc.core.image.reader",
    "read_scan": "panoloc.core.scan.reading",
}
__all__ = [
    "Ambiguous",
    "Answer",
    "Hints",
    "Localization",
    "Localized",
    "Localizer",
    "Map",
    "NotLocalized",
    "PanolocClient",
    "Rig",
    "build_map_index",
    "read_panorama",
    "read_scan",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used. Raises AttributeError for any other name."""
    if name == "__version__":
        from importlib import metadata  # a third of the start of a process that reads a scan

        return metadata.version("panoloc")
    if name not in _HOMES:
        raise AttributeError(f"module 'panoloc' has no attribute {name!r}; it offers {', '.join(__all__)}")
    return getattr(import_module(_HOMES[name]), name)
