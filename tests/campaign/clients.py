"""Clients that ask a running service without a pause, and what they got."""

import itertools
import ssl
import threading
import time
from dataclasses import dataclass, field

import httpx

from tests.integration.small_room import small_room


@dataclass
class Answers:
    """at: monotonic seconds of each end. status: 0 where there was no answer. seconds: each took. wrong: 200 with another pose."""

    at: list[float] = field(default_factory=list)
    status: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    wrong: int = 0

    def count(self, status: int) -> int:
        """Return how many had this status."""
        return self.status.count(status)


class Clients:
    """Threads that localize the same panorama until `stop`."""

    def __init__(
        self,
        url: str,
        map_id: str,
        number: int,
        timeout_s: float = 300.0,
        context: ssl.SSLContext | None = None,
    ) -> None:
        self.answers, self.number = Answers(), number
        self._context = context or True
        self._map_id, self._timeout_s = map_id, timeout_s
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._threads = [threading.Thread(target=self._ask, args=(url,), daemon=True) for _ in range(number)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> Answers:
        """Wait for the last answers and return all."""
        self._ending.set()
        for thread in self._threads:
            thread.join(self._timeout_s + 60)
        return self.answers

    def answered_since(self, when: float) -> bool:
        """Tell whether there was a right answer to a request that ended after a moment."""
        return self.num_answered_since(when) > 0

    def num_answered_since(self, when: float) -> int:
        """Return how many right answers ended after a moment."""
        with self._lock:
            ends = zip(self.answers.at, self.answers.status, strict=True)
            return sum(at > when and status == 200 for at, status in ends)

    def _ask(self, url: str) -> None:
        options = f'{{"timeout_s": {self._timeout_s:g}}}'
        with httpx.Client(base_url=url, timeout=self._timeout_s + 30, verify=self._context) as client:
            while not self._ending.is_set():
                began, status, wrong = time.monotonic(), 0, False
                try:
                    reply = client.post(
                        "/localize",
                        files={"image": ("photo.jpg", small_room().panorama)},
                        data={"map_id": self._map_id, "options": options},
                    )
                    status = reply.status_code
                    wrong = status == 200 and not small_room().error_of(reply.json()).within(0.05, 5)
                except httpx.TransportError:
                    time.sleep(0.2)
                if status == 503:  # as its Retry-After asks
                    time.sleep(1.0)
                with self._lock:
                    self.answers.at.append(time.monotonic())
                    self.answers.status.append(status)
                    self.answers.seconds.append(time.monotonic() - began)
                    self.answers.wrong += wrong


class Reader:
    """A thread that reads a page without a pause until `stop`: what an answer takes that no worker computes."""

    def __init__(self, url: str, path: str, context: ssl.SSLContext) -> None:
        self.refused: list[int] = []  # statuses other than 200, 0 where there was no answer
        self._at: list[float] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._ask, args=(url, path, context), daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Wait for the last answer."""
        self._ending.set()
        self._thread.join(60)

    def longest_without_s(self, since: float, until: float) -> float:
        """Return the longest time between two moments, monotonic seconds, in which there was no answer."""
        within = [since, *(at for at in list(self._at) if since < at < until), until]
        return max(after - before for before, after in itertools.pairwise(within))

    def _ask(self, url: str, path: str, context: ssl.SSLContext) -> None:
        with httpx.Client(base_url=url, timeout=30, verify=context) as client:
            while not self._ending.wait(0.02):
                try:
                    status = client.get(path).status_code
                except httpx.TransportError:
                    status = 0
                if status == 200:
                    self._at.append(time.monotonic())
                else:
                    self.refused.append(status)
