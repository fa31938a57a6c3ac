"""The HTTP contract as pydantic models: what may come in, and what goes out.

Requests are validated with them. The answer to a query is `service.answer.Localization`, which workers build.
"""

from service.answer import Localization
from service.http.schemas.batches import Batch, BatchOptions
from service.http.schemas.geometry import Box, Model, Vector
from service.http.schemas.health import Health, Liveness, Readiness
from service.http.schemas.localization import Hints, LocalizeOptions, PendingLocalization
from service.http.schemas.map_options import Georeference, MapOptions, MapPatch, ScanOptions, StartsOptions
from service.http.schemas.maps import Map, MapPage, MapStarts
from service.http.schemas.problem import ProblemDocument

__all__ = [
    "Batch",
    "BatchOptions",
    "Box",
    "Georeference",
    "Health",
    "Hints",
    "Liveness",
    "Localization",
    "LocalizeOptions",
    "Map",
    "MapOptions",
    "MapPage",
    "MapPatch",
    "MapStarts",
    "Model",
    "PendingLocalization",
    "ProblemDocument",
    "Readiness",
    "ScanOptions",
    "StartsOptions",
    "Vector",
]
