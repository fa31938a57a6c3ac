"""The paths of the HTTP API, one module per group."""

from fastapi import APIRouter
from fastapi.routing import APIRoute

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
ROUTERS: tuple[APIRouter, ...] = tuple(module.router for module in _GROUPS)

QUERY_ROUTES: tuple[APIRoute, ...] = tuple(
    route
    for module in (localize, geopose)
    for route in module.router.routes
    if isinstance(route, APIRoute) and "POST" in (route.methods or ())
)
"""Routes that wait for a worker: whether the queue has room is checked before the body is read."""
