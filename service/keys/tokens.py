"""Tokens of an OpenID Connect issuer, verified here with its public keys: the issuer is asked about no token."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import jwt

from panoloc.service.keys.caller import ALL_SCOPES, Caller, Scope
from panoloc.service.keys.issuer_keys import ALGORITHMS, IssuerKeys

# Between clocks that do not agree.
_LEEWAY_S = 30.0
# Other scopes of the same token are for other services: `read` alone may mean anything.
_SCOPE = re.compile(rf"panoloc[:.]({'|'.join(get_args(Scope))})")
_MOST_CHARACTERS = 255
_CLAIMS = ["exp", "iss", "aud", "sub"]


class TokenRefusedError(ValueError):
    """A token opens nothing. is_genuine: the issuer did sign it. may_be_new: its key may have been published just now."""

    def __init__(self, message: str, *, is_genuine: bool = False, may_be_new: bool = False) -> None:
        super().__init__(message)
        self.is_genuine = is_genuine
        self.may_be_new = may_be_new


@dataclass(frozen=True)
class TokenRules:
    """What tokens have to say. scopes_claim, tenant_claim: names of claims, with dots for claims inside of others."""

    issuer: str
    audience: str
    scopes_claim: str
    tenant_claim: str


class Tokens:
    """Used from one event loop."""

    def __init__(self, rules: TokenRules, keys: IssuerKeys) -> None:
        self.rules = rules
        self.keys = keys

    def caller_of(self, token: str) -> Caller:
        """Return who brings a token. Raises TokenRefusedError, which says what to correct."""
        claims = self._verified(token)
        subject, tenant = _text(claims, "sub"), _text(claims, self.rules.tenant_claim)
        scopes = _scopes(_claim(claims, self.rules.scopes_claim))
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
                f"expected a token signed with a key of {self.rules.issuer}, got one with an unknown key, "
                f"or with a key that does not support {algorithm}",
                may_be_new=True,
            )
        for key in keys:
            try:
                return self._decoded(token, key)
            except jwt.InvalidSignatureError:
                continue
        raise TokenRefusedError(f"expected a token that {self.rules.issuer} has signed, got one with a wrong signature")

    def _decoded(self, token: str, key: jwt.PyJWK) -> dict[str, Any]:
        try:
            return jwt.decode(
                token,
                key,
                algorithms=[key.algorithm_name],
                issuer=self.rules.issuer,
                audience=self.rules.audience,
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
            return f"for the audience {self.rules.audience!r}, got one for another audience"
        if isinstance(error, jwt.InvalidIssuerError):
            return f"of the issuer {self.rules.issuer!r}, got one of another issuer"
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
