"""The HTTP contract as pydantic models: requests and responses.

Requests are validated with them. The answer to a query is `service.answer.Localization`, which workers build.
"""

from service.answer import Localization
from service.http.schemas.batches import Batch, BatchOptions
from service.http.schemas.health import Health, Liveness, Readiness
from service.http.schemas.localization import LocalizeOptions, PendingLocalization
from service.http.schemas.map_options import Georeference, MapOptions, MapPatch, ScanOptions
from service.http.schemas.maps import Map, MapPage, MapStarts
from service.http.schemas.problem import ProblemDocument

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
