"""The HTTP contract as pydantic models: requests and responses.

Requests are validated with them. The answer to a query is `panoloc.service.answer.Localization`, which workers build.
"""

from panoloc.service.answer import Localization
from panoloc.service.http.schemas.batches import Batch, BatchOptions
from panoloc.service.http.schemas.health import Health, Liveness, Readiness
from panoloc.service.http.schemas.localization import LocalizeOptions, PendingLocalization
from panoloc.service.http.schemas.map_options import Georeference, MapOptions, MapPatch, ScanOptions
from panoloc.service.http.schemas.maps import Map, MapPage, MapStarts
from panoloc.service.http.schemas.problem import ProblemDocument

__all__ = [
    "Batch",
    "BatchOptions",
    "Georeference",
    "Health",
    "Liveness",
    "Localization",
    "LocalizeOptions",
    "Map",
    "MapOptions",
    "MapPage",
    "MapPatch",
    "MapStarts",
    "PendingLocalization",
    "ProblemDocument",
    "Readiness",
    "ScanOptions",
]
