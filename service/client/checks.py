"""Checks of URL and key, before anything is sent."""

import re
from urllib.parse import urlsplit

from panoloc.service.client.errors import InvalidKeyError, InvalidUrlError

_KEY = re.compile(r"[!-~]+")


def check_url(url: str) -> None:
    """Raise InvalidUrlError unless the URL can be a service's."""
    if not _is_address(url):
        raise InvalidUrlError(f"Expected a URL such as http://127.0.0.1:8000, got {url!r}; set --url or PANOLOC_URL.")


def _is_address(url: str) -> bool:
    """Return whether a URL has a scheme, a host and, if any, a valid port."""
    try:
        parts = urlsplit(url)
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def check_key(key: str | None) -> None:
    """Raise InvalidKeyError for a key that no header can carry; the message does not repeat it."""
    if key and not _KEY.fullmatch(key):
        raise InvalidKeyError(
            "Expected a key of ASCII letters, digits and punctuation, got a key with spaces, line ends or other "
            "characters, perhaps at its end; correct PANOLOC_API_KEY."
        )
