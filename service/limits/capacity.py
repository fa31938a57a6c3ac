"""How much may be under way at the same time, of all callers together and of each."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from panoloc.service.errors import BytesInFlightError, TryAgainError, UploadsError

Refusal = Literal[
    "header-bytes", "slow-body", "slow-reader", "bytes-in-flight", "uploads", "queue", "deadline", "registration",
    "request-rate", "byte-rate",
]  # fmt: skip
"""Limits that turn requests away; labels of the metric of refusals."""

_RETRY_AFTER_S = 5
# One query may bring as many bytes as four of the largest images.
_LARGEST_IMAGES, _LARGEST_IMAGES_OF_CALLER = 8, 6
_UPLOADS, _UPLOADS_OF_CALLER = 16, 8


@dataclass(eq=False)
class Capacity:
    """Counts what requests hold, such as bytes in memory or uploads. Used from one event loop.

    most, most_of_caller: of all callers, and of one. what: named in messages. refusal, error: what a refusal is counted
    and raised as. note_total: called with what is held after each change.
    """

    most: int
    most_of_caller: int
    what: str
    refusal: Refusal
    error: type[TryAgainError]
    note_refusal: Callable[[Refusal], None]
    note_total: Callable[[int], None] = lambda _: None
    _by_caller: Counter[str] = field(default_factory=Counter, init=False)

    @property
    def total(self) -> int:
        """Return how much is held now."""
        return self._by_caller.total()

    def hold(self, caller: str) -> "Held":
        """Begin to count what one request holds."""
        return Held(self, caller)

    @contextmanager
    def place(self, caller: str) -> Iterator[None]:
        """Hold one for the duration of the block. Raises the error of this capacity where there is none."""
        self.change(caller, 1)
        try:
            yield
        finally:
            self.change(caller, -1)

    def change(self, caller: str, amount: int) -> None:
        """Count more, or less where the amount is negative. Raises the error of this capacity for too much."""
        for held, most, whose in (
            (self.total, self.most, "all callers"),
            (self._by_caller[caller], self.most_of_caller, "one caller"),
        ):
            if amount > 0 and held + amount > most:
                self.note_refusal(self.refusal)
                raise self.error(
                    f"expected at most {most:,} {self.what} of {whose} at the same time, got more; try again later",
                    _RETRY_AFTER_S,
                )
        self._by_caller[caller] += amount
        if not self._by_caller[caller]:
            del self._by_caller[caller]
        self.note_total(self.total)


class Held:
    """What one request holds."""

    def __init__(self, capacity: Capacity, caller: str) -> None:
        self._capacity, self._caller, self._amount = capacity, caller, 0

    def take(self, amount: int) -> None:
        """Hold more. Raises the error of its capacity."""
        self._capacity.change(self._caller, amount)
        self._amount += amount

    def release(self) -> None:
        """Hold nothing any more; safe to call twice."""
        amount, self._amount = self._amount, 0
        if amount:
            self._capacity.change(self._caller, -amount)


def bytes_in_flight(max_image_bytes: int, note_refusal: Callable[[Refusal], None]) -> Capacity:
    """Return the capacity for images of unanswered queries, which are in the memory of this process."""
    most, most_of_caller = _LARGEST_IMAGES * max_image_bytes, _LARGEST_IMAGES_OF_CALLER * max_image_bytes
    what = "bytes of images (multiples of PANOLOC_MAX_IMAGE_BYTES)"
    return Capacity(most, most_of_caller, what, "bytes-in-flight", BytesInFlightError, note_refusal)


def upload_places(note_refusal: Callable[[Refusal], None], note_total: Callable[[int], None]) -> Capacity:
    """Return the capacity for uploads of scans and batches, each of which takes disk and a connection."""
    what = "uploads of scans and batches"
    return Capacity(_UPLOADS, _UPLOADS_OF_CALLER, what, "uploads", UploadsError, note_refusal, note_total)
