"""Asks callers for an API key or a token, when there are any, and says which maps and batches a caller sees."""

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from fastapi import Request, Security
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer

from panoloc.core.errors import ExportRefusedError
from panoloc.service.batches.record import BatchRecord
from panoloc.service.errors import (
    BatchNotFoundError,
    ExportFailedError,
    KeyMissingError,
    ScopeMissingError,
    StorageError,
)
from panoloc.service.keys.audit_log import Change
from panoloc.service.keys.caller import ALL_SCOPES, Caller, Scope
from panoloc.service.keys.tokens import TokenRefusedError
from panoloc.service.maps.known_maps import VisibleMaps
from panoloc.service.maps.record import MapRecord
from panoloc.service.services import services_of

_bearer = HTTPBearer(auto_error=False, description="Required only if the operator has set keys.")
_header = APIKeyHeader(
    name="X-API-Key", auto_error=False, description="The same key, for clients without bearer tokens."
)


def caller_of(request: Request) -> Caller:
    """Return who a request comes from: its API key or token where keys are asked for and it has one, else its
    address."""
    keys = services_of(request).settings.keys
    key = _presented(request)
    caller = keys.find(key) if key is not None and keys.required else None
    address = f"address {request.client.host if request.client else ''}"
    return caller or Caller(address, frozenset() if keys.required else ALL_SCOPES)


def require(scope: Scope) -> Callable[..., Awaitable[None]]:
    """Return a dependency that lets only callers with this scope through."""

    async def check(
        request: Request,
        # Read by `caller_of`; named here for the OpenAPI document.
        bearer: HTTPAuthorizationCredentials | None = Security(_bearer),  # noqa: B008
        header: str | None = Security(_header),
    ) -> None:
        key = _presented(request)
        if key is not None and scope not in caller_of(request).scopes:
            await _learn_new_issuer_keys(request, key)
        if scope in caller_of(request).scopes:
            await _find_what_is_named(request)
            return
        if key is None:
            raise KeyMissingError("expected an API key, got none; send the header `Authorization: Bearer KEY`")
        await _refuse_unknown(request, key)
        raise ScopeMissingError(_scope_missing(request, scope))

    return check


def maps_seen(request: Request) -> VisibleMaps:
    """Return the maps that the caller sees: his own, and those that are shared with him."""
    return services_of(request).registry.seen_by(caller_of(request).tenant)


@asynccontextmanager
async def while_there(request: Request, map_id: str) -> AsyncIterator[None]:
    """Raise MapNotFoundError in place of what fails because the map was deleted meanwhile."""
    try:
        yield
    except (StorageError, ExportFailedError, ExportRefusedError):
        await services_of(request).registry.refresh(map_id)
        maps_seen(request).get(map_id)
        raise


def own_map(request: Request, map_id: str) -> MapRecord:
    """Return a map that the caller may change. Raises MapNotFoundError, and ScopeMissingError for one that is only
    shared."""
    record = maps_seen(request).get(map_id)
    if not record.belongs_to(caller_of(request).tenant):
        raise ScopeMissingError(
            f"expected a map of your tenant, but {map_id} is only shared with it; ask the owner, or register the "
            "scan yourself"
        )
    return record


def own_batch(request: Request, batch_id: str, number: int | None = None) -> BatchRecord:
    """Return a batch of the caller. Raises BatchNotFoundError, also where it has no image of this number."""
    record = services_of(request).batches.get(batch_id, caller_of(request).tenant)
    if number is not None and number >= len(record.names):
        raise BatchNotFoundError(
            f"expected the number of an image, 0 to {len(record.names) - 1}, got {number}; see `items` of the batch"
        )
    return record


def note_change(request: Request, change: Change, what: str) -> None:
    """Write into the audit log who changed what."""
    services_of(request).audit.note(caller_of(request).id, change, what, request.state.request_id)


async def hold_upload_place(request: Request) -> AsyncIterator[None]:
    """Depend on this, after the scope, where scans or batches are uploaded: a place is held until the answer. Raises
    UploadsError."""
    with services_of(request).uploads.place(caller_of(request).id):
        yield


async def _find_what_is_named(request: Request) -> None:
    """Look for a map or batch in the path that another API replica may just have made."""
    services, named = services_of(request), request.path_params
    if "map_id" in named:
        await services.registry.find([named["map_id"]])
    if "batch_id" in named:
        await services.batches.find(named["batch_id"])


async def _learn_new_issuer_keys(request: Request, key: str) -> None:
    """Ask the issuer of tokens for its keys where this token names one that is not known yet."""
    keys = services_of(request).settings.keys
    try:
        keys.caller_of(key)
    except TokenRefusedError as error:
        if error.may_be_new and keys.tokens is not None:
            await keys.tokens.keys.refresh()


async def _refuse_unknown(request: Request, key: str) -> None:
    """Raise KeyMissingError for a key that opens nothing. Callers whose genuine token has expired do not wait: they
    guess no keys."""
    try:
        services_of(request).settings.keys.caller_of(key)
    except TokenRefusedError as error:
        if not error.is_genuine:
            await services_of(request).wrong_keys.wait(request.client.host if request.client else "")
        raise KeyMissingError(str(error)) from error


def _scope_missing(request: Request, scope: Scope) -> str:
    tokens, asked = services_of(request).settings.keys.tokens, f"{request.method} {request.url.path}"
    if tokens is not None and caller_of(request).id.startswith("token "):
        return f"expected a token with 'panoloc:{scope}' in its claim {tokens.scopes_claim!r}, got one without it for {asked}"
    return f"expected a key with the scope {scope!r}, got one without it for {asked}; use another key"


def _presented(request: Request) -> str | None:
    scheme, _, credentials = request.headers.get("Authorization", "").partition(" ")
    if scheme.lower() == "bearer" and credentials.strip():
        return credentials.strip()
    return request.headers.get("X-API-Key") or None
