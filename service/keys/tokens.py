"""Tokens of an OpenID Connect issuer, verified here with its public keys: the issuer is asked about no token."""

import asyncio
import logging
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args
from urllib.parse import urlsplit

import jwt

from panoloc.service.host_names import is_loopback
from panoloc.service.keys.caller import ALL_SCOPES, Caller, Scope

_log = logging.getLogger(__name__)

# Between clocks that do not agree.
_LEEWAY_S = 30.0
# Other scopes of the same token are for other services: `read` alone may mean anything.
_SCOPE = re.compile(rf"panoloc[:.]({'|'.join(get_args(Scope))})")
_MOST_CHARACTERS = 255
_CLAIMS = ["exp", "iss", "aud", "sub"]
_FETCH_S = 10.0  # that the issuer may take to answer
# Issuers announce the next key long before they sign with it; a file is read again at once after it changed.
_URL_AGAIN_S, _FILE_AGAIN_S = 300.0, 1.0
# Tokens that name unknown keys cause no flood of requests to the issuer.
_PAUSE_S = 10.0
ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Of public keys. Shared secrets have no place in a set that anybody may read."""


class TokenRefusedError(ValueError):
    """A token opens nothing. is_genuine: the issuer did sign it. may_be_new: its key may have been published just now."""

    def __init__(self, message: str, *, is_genuine: bool = False, may_be_new: bool = False) -> None:
        super().__init__(message)
        self.is_genuine = is_genuine
        self.may_be_new = may_be_new


class IssuerKeys:
    """The public keys that an issuer signs its tokens with: a JWK set (RFC 7517) in a file, or behind a URL.

    Used from one event loop. A failed refresh keeps the keys that were there; without any, no token is accepted."""

    def __init__(self, place: str, pause_s: float = _PAUSE_S) -> None:
        """place: a path or a URL; ValueError for one that others could answer. pause_s: seconds between requests to a URL."""
        self.place = place
        self._is_url = is_url(place)
        self._pause_s = pause_s if self._is_url else 0.0
        self._asked_s = -self._pause_s
        self._keys: tuple[jwt.PyJWK, ...] = ()
        self._asking = asyncio.Lock()

    def of(self, key_id: str | None) -> list[jwt.PyJWK]:
        """Return the keys of this id, or all where a token names none."""
        return [each for each in self._keys if key_id in (None, each.key_id)]

    async def follow(self) -> None:
        """Refresh the keys now and again, without end."""
        while True:
            await self.refresh()
            await asyncio.sleep(_URL_AGAIN_S if self._is_url and self._keys else self._pause_s or _FILE_AGAIN_S)

    async def refresh(self) -> None:
        """Read the keys again, of a URL unless that has just been done."""
        async with self._asking:
            if time.monotonic() - self._asked_s < self._pause_s:
                return
            self._asked_s = time.monotonic()
            try:
                self._keys = await asyncio.to_thread(read_keys, self.place)
            except (OSError, ValueError) as error:
                _log.error(
                    "the keys of the token issuer cannot be read",
                    extra={"place": self.place, "error": str(error), "num_known": len(self._keys)},
                )


@dataclass(frozen=True)
class Tokens:
    """Used from one event loop. scopes_claim, tenant_claim: names of claims, with dots for claims inside of others."""

    issuer: str
    audience: str
    scopes_claim: str
    tenant_claim: str
    keys: IssuerKeys

    def caller_of(self, token: str) -> Caller:
        """Return who brings a token. Raises TokenRefusedError, which says what to correct."""
        claims = self._verified(token)
        subject, tenant = _text(claims, "sub"), _text(claims, self.tenant_claim)
        scopes = _scopes(_claim(claims, self.scopes_claim))
        if "admin" in scopes:
            return Caller(f"token {subject}", ALL_SCOPES)
        return Caller(f"token {subject}", scopes, tenant)

    def _verified(self, token: str) -> dict[str, Any]:
        try:
            header = jwt.get_unverified_header(token)
        except jwt.PyJWTError as error:
            raise TokenRefusedError("expected a known API key or a token, got neither") from error
        algorithm = str(header.get("alg"))
        if algorithm not in ALGORITHMS:
            raise TokenRefusedError(
                f"expected a token signed by {', '.join(ALGORITHMS)}, got one with the algorithm {algorithm[:20]!r}"
            )
        keys = [each for each in self.keys.of(header.get("kid")) if each.algorithm_name == algorithm]
        if not keys:
            raise TokenRefusedError(
                f"expected a token signed with a key of {self.issuer}, got one with an unknown key, "
                f"or with a key that does not support {algorithm}",
                may_be_new=True,
            )
        for key in keys:
            try:
                return self._decoded(token, key)
            except jwt.InvalidSignatureError:
                continue
        raise TokenRefusedError(f"expected a token that {self.issuer} has signed, got one with a wrong signature")

    def _decoded(self, token: str, key: jwt.PyJWK) -> dict[str, Any]:
        try:
            return jwt.decode(
                token,
                key,
                algorithms=[key.algorithm_name],
                issuer=self.issuer,
                audience=self.audience,
                leeway=_LEEWAY_S,
                options={"require": _CLAIMS},
            )
        except jwt.InvalidSignatureError:
            raise
        except jwt.PyJWTError as error:
            raise TokenRefusedError(f"expected a token {self._reason(error)}", is_genuine=True) from error

    def _reason(self, error: jwt.PyJWTError) -> str:
        if isinstance(error, jwt.ExpiredSignatureError):
            return "that is still valid, got one that has expired; ask for a new one"
        if isinstance(error, jwt.InvalidAudienceError):
            return f"for the audience {self.audience!r}, got one for another audience"
        if isinstance(error, jwt.InvalidIssuerError):
            return f"of the issuer {self.issuer!r}, got one of another issuer"
        return f"that is valid now and has the claims {_CLAIMS}, but {error}"


def _claim(claims: Mapping[str, Any], name: str) -> Any:
    if name in claims:  # names may be URLs, which have dots
        return claims[name]
    found: Any = claims
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def _text(claims: Mapping[str, Any], name: str) -> str:
    """Return a claim that names somebody: it goes into logs, and into records of maps, where `*` means all."""
    value = _claim(claims, name)
    if not isinstance(value, str) or not value.isprintable() or not 0 < len(value) <= _MOST_CHARACTERS or value == "*":
        raise TokenRefusedError(
            f"expected a token whose claim {name!r} is a name of 1 to {_MOST_CHARACTERS} printable characters other "
            f"than '*', got {ascii(value)[:40]}",
            is_genuine=True,
        )
    return value


def _scopes(value: Any) -> frozenset[Scope]:
    named = value.split() if isinstance(value, str) else value if isinstance(value, list) else []
    found = [_SCOPE.fullmatch(each) for each in named if isinstance(each, str)]
    return frozenset(scope for scope in get_args(Scope) for match in found if match and match[1] == scope)


def is_url(place: str) -> bool:
    """Tell whether keys are fetched. Raises ValueError for plain HTTP over a network, where anybody could answer."""
    parts = urlsplit(place)
    if parts.scheme == "http" and not is_loopback(parts.hostname or ""):
        raise ValueError(f"expected an https:// URL or a file with the keys of the issuer, got {place!r}")
    return parts.scheme in ("http", "https")


def read_keys(place: str) -> tuple[jwt.PyJWK, ...]:
    """Return the public keys of a JWK set that sign. Blocking. Raises OSError, and ValueError where there are none."""
    try:
        if is_url(place):
            found = jwt.PyJWKClient(place, cache_jwk_set=False, timeout=_FETCH_S).get_jwk_set()
        else:
            found = jwt.PyJWKSet.from_json(Path(place).read_text())
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, jwt.PyJWTError) as error:
        raise ValueError(f'expected a JWK set, {{"keys": […]}}, but {error!r}') from error
    usable = tuple(each for each in found.keys if _is_usable(each))
    if not usable:
        raise ValueError("expected a JWK set with a public signing key (RSA, EC or Ed25519), got none")
    return usable


def _is_usable(key: jwt.PyJWK) -> bool:
    is_private = hasattr(key.key, "private_bytes")
    return key.algorithm_name in ALGORITHMS and key.public_key_use in (None, "sig") and not is_private
