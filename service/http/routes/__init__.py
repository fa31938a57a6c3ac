"""The paths of the HTTP API, one module per group."""

from fastapi import APIRouter
from fastapi.routing import APIRoute

from service.http.routes import (
    batches,
    console,
    demo,
    documentation,
    geopose,
    health,
    localizations,
    localize,
    map_files,
    maps,
    metrics,
    new_batches,
    new_scans,
    openflame,
    problems,
)

ROUTERS: tuple[APIRouter, ...] = tuple(
    module.router
    for module in (
        maps,
        new_scans,
        map_files,
        localize,
        localizations,
        geopose,
        new_batches,
        batches,
        health,
        metrics,
        demo,
        documentation,
        problems,
        openflame,
        console,
    )
)

QUERY_ROUTES: tuple[APIRoute, ...] = tuple(
    route
    for module in (localize, geopose, openflame)
    for route in module.router.routes
    if isinstance(route, APIRoute) and "POST" in (route.methods or ())
)
"""Those that wait for a worker: whether it has a place for them is looked at before their body."""
