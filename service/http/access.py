"""Asks callers for an API key, when the operator has set any."""

import hashlib
from collections.abc import Awaitable, Callable

from fastapi import Request, Security
from fastapi.security import APIKeyHeader, HTTPAuthorizationCredentials, HTTPBearer

from service.api_keys import Scope
from service.errors import KeyMissingError, ScopeMissingError
from service.services import services_of

_bearer = HTTPBearer(auto_error=False, description="Asked for only where the operator has set PANOLOC_API_KEYS.")
_header = APIKeyHeader(
    name="X-API-Key", auto_error=False, description="The same key, for clients without bearer tokens."
)


def caller_of(request: Request) -> str:
    """Return who a request counts for: its API key where keys are asked for, else its address."""
    keys = services_of(request).settings.keys
    key = request.headers.get("X-API-Key") or request.headers.get("Authorization", "").rpartition(" ")[2]
    if keys.required and keys.scopes_of(key) is not None:
        return "key " + hashlib.sha256(key.encode()).hexdigest()
    return f"address {request.client.host if request.client else ''}"


def require(scope: Scope) -> Callable[..., Awaitable[None]]:
    """Return a dependency that lets only callers with this scope through."""

    async def check(
        request: Request,
        bearer: HTTPAuthorizationCredentials | None = Security(_bearer),  # noqa: B008
        header: str | None = Security(_header),
    ) -> None:
        keys = services_of(request).settings.keys
        if not keys.required:
            return
        key = bearer.credentials if bearer else header
        if key is None:
            raise KeyMissingError("expected an API key, got none; send the header `Authorization: Bearer KEY`")
        scopes = keys.scopes_of(key)
        if scopes is None:
            await services_of(request).wrong_keys.wait(request.client.host if request.client else "")
            raise KeyMissingError("expected a known API key, got an unknown one; ask the operator for a key")
        if scope not in scopes:
            raise ScopeMissingError(f"expected a key with the scope {scope!r}, got one without it; use another key")

    return check


async def require_for_details(
    request: Request,
    bearer: HTTPAuthorizationCredentials | None = Security(_bearer),  # noqa: B008
    header: str | None = Security(_header),
) -> None:
    """Let through to metrics, documentation and details of health who may read, or everybody where the operator says so."""
    if not services_of(request).settings.open_pages:
        await _check_read(request, bearer, header)


async def sees_details(request: Request) -> bool:
    """Tell whether a caller of readiness gets more than a word: probes bring no key."""
    settings = services_of(request).settings
    return settings.open_pages or not settings.keys.required or caller_of(request).startswith("key ")


_check_read = require("read")
