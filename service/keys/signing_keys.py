"""The public keys that an issuer signs its tokens with: a JWK set (RFC 7517) in a file, or behind a URL."""

import asyncio
import json
import logging
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import jwt

from service.host_names import is_loopback

_log = logging.getLogger(__name__)

_MOST_BYTES = 2**20
_FETCH_S = 10.0
# Issuers announce the next key long before they sign with it.
_FETCH_AGAIN_S = 300.0
# Tokens that name keys nobody knows make no flood of requests to the issuer.
_SHORTEST_PAUSE_S = 10.0
# What a public key may sign with. Shared secrets have no place in a set that anybody may read.
_ALGORITHMS: Mapping[str, tuple[str, ...]] = {
    "RSA": ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512"),
    "EC P-256": ("ES256",),
    "EC P-384": ("ES384",),
    "EC P-521": ("ES512",),
    "OKP Ed25519": ("EdDSA",),
}


SIGNING_ALGORITHMS = tuple(each for group in _ALGORITHMS.values() for each in group)
_PUBLIC = ("kty", "crv", "n", "e", "x", "y")


@dataclass(frozen=True)
class SigningKey:
    """One public key. id: the `kid` of tokens that it signed, where it has one."""

    id: str | None
    algorithms: tuple[str, ...]
    key: jwt.PyJWK


class SigningKeys:
    """Used from one event loop. What cannot be read or fetched leaves the keys that were there; without any, no token is right."""

    def __init__(self, place: str, look_s: float = 1.0, shortest_pause_s: float = _SHORTEST_PAUSE_S) -> None:
        """place: a path, or a URL for which `follow` has to run. Raises ValueError for a URL that others could answer."""
        self.place = place
        self._is_url = is_url(place)
        self._look_s = look_s
        self._shortest_pause_s = shortest_pause_s
        self._looked_s = -look_s
        self._fetched_s = -shortest_pause_s
        self._seen: tuple[int, int] | None = None
        self._keys: tuple[SigningKey, ...] = ()
        self._fetching = asyncio.Lock()

    def that_may_have_signed(self, key_id: str | None, algorithm: str) -> list[SigningKey]:
        """Return the keys of this id, or all where a token names none, as far as the algorithm is one of theirs."""
        self._look()
        return [each for each in self._keys if key_id in (None, each.id) and algorithm in each.algorithms]

    async def follow(self) -> None:
        """Fetch the keys of a URL now and every few minutes, for ever; of a file nothing has to be done."""
        while self._is_url:
            await self.fetch()
            await asyncio.sleep(_FETCH_AGAIN_S if self._keys else self._shortest_pause_s)

    async def fetch(self) -> bool:
        """Fetch the keys of a URL unless that has just been done; tell whether it was."""
        if not self._is_url:
            return False
        async with self._fetching:
            if time.monotonic() - self._fetched_s < self._shortest_pause_s:
                return False
            self._fetched_s = time.monotonic()
            try:
                self._take(await _fetched(self.place))
            except (httpx.HTTPError, ValueError) as error:
                self._tell(error)
                return False
            return True

    def _look(self) -> None:
        if self._is_url or time.monotonic() - self._looked_s < self._look_s:
            return
        self._looked_s = time.monotonic()
        path = Path(self.place)
        try:
            found = os.stat(path)
            if self._seen == (seen := (found.st_mtime_ns, found.st_size)):
                return
            self._seen = seen
            self._take(path.read_bytes()[:_MOST_BYTES])
        except (OSError, ValueError) as error:
            self._seen = None
            self._tell(error)

    def _take(self, document: bytes) -> None:
        self._keys = keys_of(document)

    def _tell(self, error: Exception) -> None:
        _log.error(
            "the keys of the issuer of tokens cannot be read",
            extra={"place": self.place, "error": str(error) or type(error).__name__, "num_known": len(self._keys)},
        )


def is_url(place: str) -> bool:
    """Tell whether keys are fetched. Raises ValueError for plain HTTP over a network, where others could answer with theirs."""
    parts = urlsplit(place)
    if parts.scheme == "http" and not is_loopback(parts.hostname or ""):
        raise ValueError(f"expected https:// or a file for the keys of the issuer, got {place!r}")
    return parts.scheme in ("http", "https")


def keys_of(document: bytes) -> tuple[SigningKey, ...]:
    """Return the public keys of a JWK set that sign; others are left out. Raises ValueError where there are none."""
    try:
        listed = json.loads(document)["keys"]
        usable = tuple(
            SigningKey(each.get("kid"), _algorithms_of(each), _public(each))
            for each in listed
            if _algorithms_of(each) and each.get("use", "sig") == "sig"
        )
    except (ValueError, KeyError, TypeError, AttributeError, jwt.PyJWTError) as error:
        raise ValueError(f'expected a JWK set, {{"keys": […]}}, but {error!r}') from error
    if not usable:
        raise ValueError("expected a JWK set with a public key that signs (RSA, EC or Ed25519), got none")
    return usable


def _algorithms_of(key: Mapping[str, str]) -> tuple[str, ...]:
    kind = " ".join(filter(None, (key.get("kty"), key.get("crv"))))
    return tuple(each for each in _ALGORITHMS.get(kind, ()) if key.get("alg") in (None, each))


def _public(key: Mapping[str, str]) -> jwt.PyJWK:
    # A set with private parts, given by mistake, is good for what its public ones are.
    return jwt.PyJWK({name: key[name] for name in _PUBLIC if name in key}, algorithm=_algorithms_of(key)[0])


async def _fetched(url: str) -> bytes:
    async with (
        httpx.AsyncClient(timeout=_FETCH_S, follow_redirects=False) as client,
        client.stream("GET", url, headers={"Accept": "application/json"}) as reply,
    ):
        reply.raise_for_status()
        document = b""
        async for piece in reply.aiter_bytes():
            document += piece
            if len(document) > _MOST_BYTES:
                raise ValueError(f"expected at most {_MOST_BYTES} bytes")
        return document
