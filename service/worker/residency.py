"""A cache in memory: least recently used out, bounded by bytes."""

from collections.abc import Hashable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """A value that knows its size in memory."""

    @property
    def num_bytes(self) -> int:
        """Return the bytes held."""


Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Sized)


class Residency(Generic[Key, Value]):
    """Not thread-safe: a worker computes in one thread."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._held: dict[Key, Value] = {}  # the least recently used first

    @property
    def num_bytes(self) -> int:
        """Return the bytes of everything held."""
        return sum(value.num_bytes for value in self._held.values())

    def get(self, key: Key) -> Value | None:
        """Return a value, None when it is not held; it becomes the most recently used."""
        if key in self._held:
            self._held[key] = self._held.pop(key)
        return self._held.get(key)

    def put(self, key: Key, value: Value) -> None:
        """Hold a value that is not held yet, unless it is larger than the whole cache."""
        if value.num_bytes <= self._max_bytes:
            while self.num_bytes + value.num_bytes > self._max_bytes:
                del self._held[next(iter(self._held))]
            self._held[key] = value
