"""Names of hosts: what may be one, and which are of this machine alone."""

import ipaddress
import re

_NAME = re.compile(r"[\w-]+(\.[\w-]+)*\.?")
_DEFAULT_PORT = re.compile(r"^(http(?=:.*:80$)|https(?=:.*:443$))(.*):\d+$")  # which browsers leave out
_ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/?#\s*]+")


def host_names(text: str) -> list[str]:
    """Return the names in a text, separated by commas; `*` stands for all. Raises ValueError for what no `Host` header names."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name != "*" and not _NAME.fullmatch(name):
            raise ValueError(f"expected names such as panoloc.example.org, without https:// and port, got {name!r}")
    return [name.rstrip(".") for name in names]


def origins(text: str) -> list[str]:
    """Return the origins in a text, separated by commas; `*` stands for all. Raises ValueError for what no `Origin` header names."""
    found = [_DEFAULT_PORT.sub(r"\1\2", name.strip().rstrip("/").lower()) for name in text.split(",") if name.strip()]
    for name in found:
        if name != "*" and not _ORIGIN.fullmatch(name):
            raise ValueError(
                f"expected origins such as https://app.example.org, with scheme and without path, got {name!r}"
            )
    return found


def is_address(host: str) -> bool:
    """Tell whether a host is an IP address."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def is_loopback(host: str) -> bool:
    """Tell whether only this machine reaches who listens on `host`, a name or an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
