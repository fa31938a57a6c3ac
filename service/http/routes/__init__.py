"""The paths of the HTTP API, one module per group."""

from fastapi import APIRouter

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
