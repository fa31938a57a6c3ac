"""The bytes of uploads that lie in the memory of this process, of all callers and of each."""

from collections import Counter
from collections.abc import Callable

from service.errors import BytesInFlightError
from service.limits.connection_limits import Refusal

_RETRY_AFTER_S = 5


class BytesInFlight:
    """Counts bytes until the request that brought them has been answered. Used from one event loop."""

    def __init__(self, most: int, most_of_caller: int, note_refusal: Callable[[Refusal], None]) -> None:
        self._most = most
        self._most_of_caller = most_of_caller
        self._note_refusal = note_refusal
        self._by_caller: Counter[str] = Counter()

    @property
    def total(self) -> int:
        """Return how many there are now."""
        return self._by_caller.total()

    def hold(self, caller: str) -> "HeldBytes":
        """Begin to count the bytes of one request."""
        return HeldBytes(self, caller)

    def take(self, caller: str, num_bytes: int) -> None:
        """Count more bytes. Raises BytesInFlightError where there are too many."""
        for held, most, whose, setting in (
            (self.total, self._most, "all callers", "PANOLOC_MAX_BYTES_IN_FLIGHT"),
            (self._by_caller[caller], self._most_of_caller, "one caller", "PANOLOC_MAX_BYTES_IN_FLIGHT_PER_CALLER"),
        ):
            if held + num_bytes > most:
                self._note_refusal("bytes-in-flight")
                raise BytesInFlightError(
                    f"expected at most {most:,} bytes of images of {whose} at the same time ({setting}), got more; try again when "
                    "others are answered, or send smaller images",
                    _RETRY_AFTER_S,
                )
        self._by_caller[caller] += num_bytes

    def give_back(self, caller: str, num_bytes: int) -> None:
        """Forget bytes."""
        self._by_caller[caller] -= num_bytes
        if self._by_caller[caller] <= 0:
            del self._by_caller[caller]


class HeldBytes:
    """The bytes of one request."""

    def __init__(self, all_bytes: BytesInFlight, caller: str) -> None:
        self._all = all_bytes
        self._caller = caller
        self._num_bytes = 0

    def take(self, num_bytes: int) -> None:
        """Count more. Raises BytesInFlightError."""
        self._all.take(self._caller, num_bytes)
        self._num_bytes += num_bytes

    def release(self) -> None:
        """Forget all; safe to call twice."""
        if self._num_bytes:
            self._all.give_back(self._caller, self._num_bytes)
        self._num_bytes = 0
