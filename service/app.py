"""Puts the HTTP application together. Imports neither torch nor Ray nor the algorithm, so that it answers at once."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware

from panoloc.service.cache import Cache
from panoloc.service.host.certificates import names_in
from panoloc.service.host_names import host_names, origins
from panoloc.service.http.error_handlers import install_error_handlers
from panoloc.service.http.guards.early_refusals import CallerRateCheck, QueueCheck
from panoloc.service.http.guards.host_check import HostCheck
from panoloc.service.http.guards.slow_clients import SlowClients
from panoloc.service.http.idempotency import Idempotency
from panoloc.service.http.openapi import install_openapi
from panoloc.service.http.request_context import RecentErrors, RequestContext
from panoloc.service.http.responses import Compression, NotModified
from panoloc.service.http.routes import QUERY_ROUTES, ROUTES
from panoloc.service.jobs import WorkerPool
from panoloc.service.services import Services
from panoloc.service.settings import Settings
from panoloc.service.storage import Storage, open_storage

_DESCRIPTION = """Finds where a 360° photo was taken inside a scanned place.

1. `POST /maps` with a coloured scan; poll `GET /maps/{id}` until it is `ready`.
2. `POST /localize` with a panorama and the map's id.

Positions are metres in the map's own frame, angles degrees, times UTC. Every error is a problem document (RFC 9457)."""

# Of headers of answers, what pages of other origins may read.
_EXPOSED = ["Content-Location", "ETag", "Location", "Preference-Applied", "Retry-After", "X-Request-Id"]
_EXPOSED += ["Idempotent-Replayed", "RateLimit", "RateLimit-Policy"]
_TAGS = {
    "maps": "Register scans, and look at what became of them.",
    "localization": "Find where images were taken.",
    "batches": "Find where folders of photos were taken, and export them.",
    "operations": "For operators and newcomers: health, metrics, and a room to try.",
}


def create_app(settings: Settings, pool: WorkerPool, storage: Storage | None = None) -> FastAPI:
    """Return the application; its lifespan starts and stops the pool. storage: None for that of the settings."""
    if settings.redis_url is None:
        raise ValueError("expected settings with a redis_url, got none; start a Redis first")
    cache = Cache(settings.redis_url, result_lifetime_s=settings.result_ttl_s)
    services = Services(settings, pool, cache, storage or open_storage(settings.storage_url, settings.bucket_access))

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await services.start()
        try:
            yield
        finally:
            await services.stop()

    app = FastAPI(
        title="panoloc",
        version=version("panoloc"),
        description=_DESCRIPTION,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        contact={"name": "The operator of this service"},
        servers=[{"url": "/"}],
        openapi_tags=[{"name": name, "description": what} for name, what in _TAGS.items()],
        lifespan=lifespan,
        openapi_url=None,
    )
    app.state.services = services
    app.state.recent_errors = RecentErrors()
    app.add_middleware(Idempotency, cache=cache, is_there=services.is_there)
    app.add_middleware(NotModified)
    app.add_middleware(QueueCheck, services=services, routes=QUERY_ROUTES)
    app.add_middleware(CallerRateCheck, rates=services.rates)
    # Who points another name here has no certificate for it.
    certified = [] if settings.tls_cert is None else names_in(settings.tls_cert)
    app.add_middleware(
        HostCheck,
        allowed=[*host_names(settings.allowed_hosts), *certified],
        origins=origins(settings.allowed_origins),
        is_needed=lambda: not settings.keys.required,
    )
    if settings.allowed_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=origins(settings.allowed_origins),
            allow_methods=["*"],
            allow_headers=["*"],
            allow_private_network=True,  # a page of the internet that the operator names may call a scanner in the local network
            expose_headers=_EXPOSED,
        )
    app.add_middleware(RequestContext, metrics=services.metrics, errors=app.state.recent_errors)
    app.add_middleware(Compression)  # beyond what reads problems on their way out
    app.add_middleware(SlowClients, note_refusal=services.metrics.note_refusal)
    install_error_handlers(app)
    app.router.routes.extend(ROUTES)
    install_openapi(app)
    return app
