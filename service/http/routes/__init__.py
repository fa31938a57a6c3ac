"""The paths of the HTTP API, one module per group."""

from fastapi.routing import APIRoute
from starlette.routing import BaseRoute

from panoloc.service.http.routes import (
    batches,
    control,
    geopose,
    hand_poses,
    localize,
    map_changes,
    map_files,
    map_links,
    maps,
    new_batches,
    new_scans,
    operations,
    pages,
)

_GROUPS = (
    maps,
    new_scans,
    map_files,
    map_changes,
    map_links,
    control,
    localize,
    geopose,
    new_batches,
    batches,
    hand_poses,
    operations,
    pages,
)
ROUTES: tuple[BaseRoute, ...] = tuple(route for module in _GROUPS for route in module.router.routes)
"""What an application answers. Routers that it includes would have each route analysed once more, at the first request."""

QUERY_ROUTES: tuple[APIRoute, ...] = tuple(
    route
    for module in (localize, geopose)
    for route in module.router.routes
    if isinstance(route, APIRoute) and "POST" in (route.methods or ())
)
"""Routes that wait for a worker: whether the queue has room is checked before the body is read."""
