"""Whether the service can listen on an address, found out before anything is started for it."""

import errno
import socket


def why_not_free(host: str, port: int) -> str | None:
    """Return why nobody can listen on `host` and `port` now, None when all is well.

    host: a name or an address, empty for all addresses of this machine; a name with several addresses needs one of
    them to exist and all that exist to be free. port: 0 for any free one.
    """
    place = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    try:
        found = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (socket.gaierror, UnicodeError) as error:
        return f"expected an address of this machine, got {host!r} ({error})"
    faults = [_fault_of(family, address) for family, _, _, _, address in found]
    numbers = {fault.errno for fault in faults if fault is not None}
    if errno.EADDRINUSE in numbers:
        return f"the address {place} is taken: another program listens on it (another panoloc?); stop that program"
    if errno.EACCES in numbers:
        return f"this user may not listen on {place}; use a port from 1024 up, or grant the privilege"
    # "localhost" has an IPv6 address on machines without IPv6, too.
    if None not in faults:
        return f"expected an address of this machine, got {place}, where no program can listen ({faults[0]})"
    return None


def _fault_of(family: int, address: tuple[object, ...]) -> OSError | None:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            # As the server does: connections that have just ended on this port do not count.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            probe.bind(address)
    except OSError as error:
        return error
    return None
