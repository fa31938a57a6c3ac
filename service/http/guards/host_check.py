"""Checks the host and origin of requests to a service that asks for no key.

A browser sends requests of any page to any address that it reaches, this machine included. Two headers give such a
request away: `Host` names the other site where its DNS points here (DNS rebinding), and `Origin` names the page.
"""

import socket
from collections.abc import Callable, Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from panoloc.service.errors import HostCheckError
from panoloc.service.host_names import is_address
from panoloc.service.http.error_handlers import problem_response

_HARMLESS = frozenset({"GET", "HEAD", "OPTIONS"})


class HostCheck:
    """ASGI middleware. allowed: names besides addresses, `localhost` and this machine's own; `*` for all. is_needed:
    while no key is."""

    def __init__(
        self, app: ASGIApp, allowed: Collection[str], origins: Collection[str], is_needed: Callable[[], bool]
    ) -> None:
        self._app = app
        self._origins = frozenset(origins)
        self._is_needed = is_needed
        self._allowed = {name.lower() for name in allowed} | {"localhost", socket.gethostname().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "http" and "*" not in self._allowed and self._is_needed():
            error = self._error_of(scope["method"], Headers(scope=scope))
            if error is not None:
                await problem_response(error, scope["state"]["request_id"])(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _error_of(self, method: str, headers: Headers) -> HostCheckError | None:
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        unknown = [host for host in hosts if host and not self._is_allowed(_name_of(host))]
        if unknown or len(hosts) > 1:
            got = ", ".join(unknown or hosts)[:80]
            return HostCheckError(
                f"expected a request to an address or an allowed host name of this service, got one to {got!r}; "
                "ask the operator to add the name to PANOLOC_ALLOWED_HOSTS, or to set API keys"
            )
        host = hosts[0].lower() if hosts else ""
        if origins and ("*" in self._origins or {origin.lower() for origin in origins} <= self._origins):
            return None
        is_foreign = any(urlsplit(origin).netloc.lower() != host for origin in origins)
        if method not in _HARMLESS and (is_foreign or headers.get("sec-fetch-site") in ("cross-site", "same-site")):
            got = (", ".join(origins) or "another page")[:80]
            return HostCheckError(
                f"expected a change from a program or from a page of this service, got one from {got!r}; "
                "to allow pages of other sites, name them in PANOLOC_ALLOWED_ORIGINS"
            )
        return None

    def _is_allowed(self, name: str) -> bool:
        # DNS cannot point an address elsewhere.
        return name in self._allowed or name.endswith(".localhost") or is_address(name)


def _name_of(host: str) -> str:
    """Return the name in a `Host` header, without its port."""
    name = host.rpartition("]")[0].lstrip("[") if host.startswith("[") else host.partition(":")[0]
    return name.lower().rstrip(".")
