"""How many uploads of scans and batches may come at the same time, of all callers and of each: each takes disk and a connection."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from service.errors import UploadsError
from service.limits.connection_limits import Refusal

_RETRY_AFTER_S = 5


class UploadPlaces:
    """Used from one event loop. note_refusal: told why something was refused. note_number: told how many there are now."""

    def __init__(
        self,
        most: int,
        most_of_caller: int,
        note_refusal: Callable[[Refusal], None],
        note_number: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._most = most
        self._most_of_caller = most_of_caller
        self._note_refusal = note_refusal
        self._note_number = note_number
        self._by_caller: Counter[str] = Counter()

    @contextmanager
    def place(self, caller: str) -> Iterator[None]:
        """Hold a place for the duration of the block. Raises UploadsError where there is none."""
        for num, most, whose, setting in (
            (self._by_caller.total(), self._most, "all callers", "PANOLOC_MAX_UPLOADS"),
            (self._by_caller[caller], self._most_of_caller, "one caller", "PANOLOC_MAX_UPLOADS_PER_CALLER"),
        ):
            if num >= most:
                self._note_refusal("uploads")
                raise UploadsError(
                    f"expected at most {most} uploads of scans and batches of {whose} at the same time ({setting}), got one more; try "
                    "again when others are done",
                    _RETRY_AFTER_S,
                )
        self._by_caller[caller] += 1
        self._note_number(self._by_caller.total())
        try:
            yield
        finally:
            self._by_caller[caller] -= 1
            if not self._by_caller[caller]:
                del self._by_caller[caller]
            self._note_number(self._by_caller.total())
