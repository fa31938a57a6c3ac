"""How many connections there may be, how large the head of a request, and how slow a client."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

Refusal = Literal[
    "connections", "connections-of-address", "header-bytes", "no-http", "slow-header", "slow-body", "slow-reader", "bytes-in-flight",
    "uploads", "queue", "deadline", "registration", "request-rate", "byte-rate",
]  # fmt: skip


@dataclass(frozen=True)
class ConnectionLimits:
    """Limits of the settings of the same names.

    connections, of one address: at the same time. header_bytes: of the request line and all headers. header_timeout_s: until they are
    there. transfer_timeout_s: for which a body, or the reading of an answer, may be below bytes_per_s.
    """

    connections: int
    connections_of_address: int
    header_bytes: int
    header_timeout_s: float
    transfer_timeout_s: float
    bytes_per_s: float


class Connection(Protocol):
    """What a connection that is counted can be asked."""

    def give_way(self) -> None:
        """End, as one that has nothing under way."""


class ConnectionCount:
    """Counts the connections of a server. Used from one event loop. note_refusal: told why something was refused.

    An idle connection gives way to a new one, the longest idle first: a client holds on to it only to spare itself a handshake.
    """

    def __init__(self, limits: ConnectionLimits, note_refusal: Callable[[Refusal], None]) -> None:
        self.limits = limits
        self.note_refusal = note_refusal
        self._by_address: Counter[str] = Counter()
        self._idle: dict[Connection, str] = {}

    def why_not(self, address: str) -> tuple[Refusal, str] | None:
        """Return why this address gets no further connection, None when it does."""
        total, of_address = self._by_address.total(), self._by_address[address]
        if total >= self.limits.connections:
            return "connections", _too_many(self.limits.connections, "PANOLOC_MAX_CONNECTIONS")
        if of_address >= self.limits.connections_of_address:
            setting = "PANOLOC_MAX_CONNECTIONS_PER_ADDRESS"
            return "connections-of-address", _too_many(self.limits.connections_of_address, setting)
        return None

    def make_room(self, address: str) -> None:
        """Let an idle connection give way where a limit leaves none for this address; of an address at its own limit, one of its own."""
        if self._by_address[address] >= self.limits.connections_of_address:
            idle = [connection for connection, whose in self._idle.items() if whose == address]
        elif self._by_address.total() >= self.limits.connections:
            idle = list(self._idle)
        else:
            return
        for longest in idle[:1]:
            longest.give_way()

    def add(self, address: str) -> None:
        """Count a connection."""
        self._by_address[address] += 1

    def remove(self, address: str) -> None:
        """Forget a connection."""
        self._by_address[address] -= 1
        if self._by_address[address] <= 0:
            del self._by_address[address]

    def rests(self, connection: Connection, address: str) -> None:
        """Know a counted connection as idle from now on."""
        self._idle[connection] = address

    def works(self, connection: Connection) -> None:
        """Know a connection as one with something under way, or gone."""
        self._idle.pop(connection, None)


def _too_many(limit: int, setting: str) -> str:
    return f"expected fewer than {limit} connections at the same time ({setting}), got as many; use fewer and try again"
