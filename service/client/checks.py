"""What a client is given by people, looked at before anything is sent."""

import re
from urllib.parse import urlsplit

from service.client.errors import InvalidKeyError, InvalidUrlError

_KEY = re.compile(r"[!-~]+")


def check_url(url: str) -> None:
    """Raise InvalidUrlError for what is no address of a service."""
    if not _is_address(url):
        raise InvalidUrlError(f"Expected a URL such as http://127.0.0.1:8000, got {url!r}; set --url or PANOLOC_URL.")


def _is_address(url: str) -> bool:
    """Tell whether a URL has a host, and a port that is a number where it has one."""
    try:
        parts = urlsplit(url)
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def check_key(key: str | None) -> None:
    """Raise InvalidKeyError, which does not repeat it, for a key that no header can carry."""
    if key and not _KEY.fullmatch(key):
        raise InvalidKeyError(
            "Expected a key without spaces, line ends or letters beyond ASCII, got some, perhaps at its end; correct PANOLOC_API_KEY."
        )
