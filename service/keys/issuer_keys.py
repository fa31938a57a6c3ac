"""The public keys that an issuer signs its tokens with: a JWK set (RFC 7517) in a file, or behind a URL."""

import asyncio
import logging
import time
from pathlib import Path
from urllib.parse import urlsplit

import jwt

from panoloc.service.host_names import is_loopback

_log = logging.getLogger(__name__)

_FETCH_S = 10.0  # that the issuer may take to answer
# Issuers announce the next key long before they sign with it; a file is read again at once after it changed.
_URL_AGAIN_S, _FILE_AGAIN_S = 300.0, 1.0
# Tokens that name unknown keys cause no flood of requests to the issuer.
_PAUSE_S = 10.0
ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Of public keys. Shared secrets have no place in a set that anybody may read."""


class IssuerKeys:
    """Used from one event loop. A failed refresh keeps the keys that were there; without any, no token is accepted."""

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
