"""What a worker keeps in memory: least recently used out, counted in bytes."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, Protocol, TypeVar


class Sized(Protocol):
    """Anything that knows how much memory it holds."""

    @property
    def num_bytes(self) -> int:
        """Return the bytes held."""


Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value", bound=Sized)


class Residency(Generic[Key, Value]):
    """A cache bounded by bytes. Not safe for several threads: a worker computes in one."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._held: OrderedDict[Key, Value] = OrderedDict()
        self._num_bytes = 0

    def __contains__(self, key: Key) -> bool:
        return key in self._held

    @property
    def num_bytes(self) -> int:
        """Return the bytes of everything held."""
        return self._num_bytes

    def get_or_load(self, key: Key, load: Callable[[], Value]) -> Value:
        """Return the value of `key`, loading it when it is not held.

        A value larger than the whole cache is returned but not kept.
        """
        if key in self._held:
            self._held.move_to_end(key)
            return self._held[key]
        value = load()
        if value.num_bytes <= self._max_bytes:
            self._make_room(value.num_bytes)
            self._held[key] = value
            self._num_bytes += value.num_bytes
        return value

    def _make_room(self, num_bytes: int) -> None:
        while self._held and self._num_bytes + num_bytes > self._max_bytes:
            _, oldest = self._held.popitem(last=False)
            self._num_bytes -= oldest.num_bytes
