"""Which names and addresses are of this machine alone."""

import ipaddress


def is_loopback(host: str) -> bool:
    """Tell whether only this machine reaches who listens on `host`, a name or an address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")
