"""Slows down callers who try keys: a wrong key is refused after a pause for each that this address has waiting."""

import asyncio
from collections import Counter

from panoloc.service.errors import WrongKeysError

_PAUSE_S = 1.0
_MOST_WAITING = 8


class WrongKeys:
    """Used from one event loop. Right keys never wait, even of an address that many share."""

    def __init__(self, pause_s: float = _PAUSE_S, most_waiting: int = _MOST_WAITING) -> None:
        self._pause_s = pause_s
        self._most_waiting = most_waiting
        self._waiting: Counter[str] = Counter()

    async def wait(self, address: str) -> None:
        """Wait before a wrong key of this address is refused. Raises WrongKeysError where many wait already."""
        if self._waiting[address] >= self._most_waiting:
            raise WrongKeysError(
                f"expected a known API key, got {self._most_waiting} unknown ones from this address within seconds; "
                "ask the operator for a key",
                round(self._most_waiting * self._pause_s) or 1,
            )
        self._waiting[address] += 1
        try:
            await asyncio.sleep(self._pause_s * self._waiting[address])
        finally:
            self._waiting[address] -= 1
            if not self._waiting[address]:
                del self._waiting[address]
