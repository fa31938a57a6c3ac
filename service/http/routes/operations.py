"""For operators and newcomers: health, metrics, what each kind of problem means, and a synthetic room to try."""

import asyncio
import time
from importlib.metadata import version
from typing import Any

from fastapi import Depends, Request
from prometheus_client import CONTENT_TYPE_LATEST
from starlette.responses import JSONResponse, Response

from panoloc.service.errors import CacheDownError, StorageAwayError, StorageFullError, StorageReadOnlyError
from panoloc.service.http.access import caller_of, require
from panoloc.service.http.error_handlers import plain_problem_response
from panoloc.service.http.openapi import Router, file_response
from panoloc.service.http.schemas.operations import Health, Liveness, PoolHealth, Readiness
from panoloc.service.problems import HTTP_PROBLEMS, error_responses, known_problems
from panoloc.service.services import Services, services_of

router = Router(tags=["operations"])

_RETRY_AFTER_S = 2
_OPEN: dict[str, Any] = {"security": []}  # to callers without a key


@router.get(
    "/health/live",
    summary="Check that the process runs",
    responses={200: {"model": Liveness}, **error_responses(403)},
    openapi_extra=_OPEN,
)
async def live() -> Response:
    """Answer as long as the process runs."""
    return JSONResponse({"status": "live"})


@router.get(
    "/health/ready",
    summary="Check that requests are served",
    responses={
        200: {"model": Health | Readiness},
        503: {
            "model": Health | Readiness,
            "description": "Not yet; `waiting_for` lists the missing parts.",
            "headers": {"Retry-After": {"required": True, "schema": {"type": "integer"}}},
        },
        **error_responses(403),
    },
    openapi_extra=_OPEN,
)
async def ready(request: Request) -> Response:
    """Answer 200 when Redis takes values, the storage can be written, a worker is up and start-up is over.

    With keys set, a caller without a key gets only the status, because probes send no key.
    """
    caller = caller_of(request)
    details = await _details(services_of(request), caller.tenant)
    is_ready = details["status"] == "ready"
    if "read" not in caller.scopes:
        details = {"status": details["status"]}
    if is_ready:
        return JSONResponse(details)
    return JSONResponse(details, 503, {"Retry-After": str(_RETRY_AFTER_S)})


@router.get(
    "/health",
    summary="Show details for people",
    dependencies=[Depends(require("read"))],
    responses={200: {"model": Health}, **error_responses(401, 403, 429)},
)
async def health(request: Request) -> Response:
    """Return the same details as readiness, always with 200, and the latest problems of requests and registrations."""
    services = services_of(request)
    tenant = caller_of(request).tenant
    details = await _details(services, tenant)
    # Problems name maps and batches, so only callers who see those of all tenants see problems.
    errors = request.app.state.recent_errors.newest(services.registry.failed()) if tenant is None else []
    return JSONResponse({**details, "recent_errors": errors})


@router.get(
    "/metrics",
    summary="Metrics for Prometheus",
    dependencies=[Depends(require("read"))],
    response_class=Response,
    responses={
        200: {"description": "Prometheus text format.", "content": {"text/plain": {"schema": {"type": "string"}}}},
        **error_responses(401, 403, 429),
    },
)
async def metrics(request: Request) -> Response:
    """Return requests, stages, queue, workers, index loads and resident bytes."""
    return Response(services_of(request).metrics.text(), headers={"Content-Type": CONTENT_TYPE_LATEST})


@router.get(
    "/problems/{slug}",
    summary="Explain a kind of problem",
    response_model=None,
    responses=error_responses(404),
    openapi_extra=_OPEN,
)
async def problem(request: Request, slug: str) -> Response:
    """Explain the `type` of a problem document."""
    found = known_problems().get(slug)
    if found is None:
        detail = f"expected the end of a problem's type, got {slug[:80]!r}; one of {', '.join(known_problems())}"
        return plain_problem_response(HTTP_PROBLEMS[404], detail, request)
    return JSONResponse({"type": found.type, "title": found.title, "status": found.status, "advice": found.advice})


@router.get(
    "/demo/room.ply",
    summary="The scan of a synthetic room",
    dependencies=[Depends(require("read"))],
    response_class=Response,
    responses=file_response("A coloured point cloud.", ("application/ply",), 401, 403, 503),
)
async def get_room(request: Request) -> Response:
    """Return a scan to register. The first request generates it, which takes some seconds."""
    return Response(await services_of(request).demo_room.file("room.ply"), media_type="application/ply")


@router.get(
    "/demo/panorama.jpg",
    summary="A panorama of the synthetic room, taken after furniture was moved",
    dependencies=[Depends(require("read"))],
    response_class=Response,
    responses=file_response("An equirectangular panorama.", ("image/jpeg",), 401, 403, 503),
)
async def get_panorama(request: Request) -> Response:
    """Return a panorama to localize in the map of that scan."""
    return Response(await services_of(request).demo_room.file("panorama.jpg"), media_type="image/jpeg")


async def _details(services: Services, tenant: str | None) -> dict[str, object]:
    """Return the details of health. tenant: whose maps are counted, None for all."""
    pool = services.pool.state()
    redis_is_up = await _redis_is_up(services)
    waiting_for = [] if redis_is_up else ["Redis"]
    lack = await _lack_of_storage(services)
    waiting_for += [] if lack is None else [lack]
    waiting_for += [] if pool.ready else [pool.waiting_for or "workers"]
    return {
        "status": "not_ready" if waiting_for else "ready",
        "waiting_for": waiting_for,
        "version": version("panoloc"),
        "uptime_s": round(time.monotonic() - services.began, 1),
        "redis": "up" if redis_is_up else "down",
        "storage": "writable" if lack is None else "not_writable",
        "workers": {name: getattr(pool, name) for name in PoolHealth.model_fields},
        "maps": dict(services.registry.seen_by(tenant).num_by_status()),
    }


async def _lack_of_storage(services: Services) -> str | None:
    try:
        await asyncio.to_thread(services.storage.check_writable)
    except StorageFullError:
        return "room on the disk" if not services.settings.has_bucket else "room on the disk or in the bucket"
    except StorageAwayError:
        return "the bucket"
    except (StorageReadOnlyError, OSError):
        return f"a {'bucket' if services.settings.has_bucket else 'data folder'} that can be written"
    return None


async def _redis_is_up(services: Services) -> bool:
    try:
        await services.cache.check_writable()
    except CacheDownError:
        return False
    return True
