"""Holds one blocking call back in its thread, so that what comes in meanwhile comes in for certain."""

import asyncio
import threading
from typing import Any

import pytest

_TIMEOUT_S = 10.0


class HeldCall:
    """The first call of `method` whose first argument ends with `key_end` waits until it is let go."""

    def __init__(self, patch: pytest.MonkeyPatch, owner: object, method: str, key_end: str) -> None:
        self._key_end = key_end
        self._call = getattr(owner, method)
        self._begun = threading.Event()
        self._may_go_on = threading.Event()
        patch.setattr(owner, method, self._held)

    async def begun(self) -> None:
        """Wait until the call has come."""
        assert await asyncio.to_thread(self._begun.wait, _TIMEOUT_S), "nobody called"

    def let_go(self) -> None:
        """Let the call go on."""
        self._may_go_on.set()

    def _held(self, key: str, *arguments: Any) -> Any:
        if key.endswith(self._key_end) and not self._begun.is_set():
            self._begun.set()
            assert self._may_go_on.wait(_TIMEOUT_S), "nobody let the call go on"
        return self._call(key, *arguments)


async def long_enough() -> None:
    """Give everything that does not wait the time to happen."""
    await asyncio.sleep(0.2)
