"""In which order queries go to the workers: as they came.

Those that Ray Serve has no room for try again and again, after pauses of up to half a second and in any order: a worker stands idle
meanwhile, and who comes last may be first. So Serve is handed no more than the workers have room for.
"""

import asyncio
import heapq
import itertools


class Turns:
    """Used from one event loop, so it needs no lock."""

    def __init__(self, places: int) -> None:
        """places: how many may have their turn at the same time."""
        self._places = places
        self._num_taken = 0
        self._numbers = itertools.count()
        self._waiting: list[tuple[int, asyncio.Future[None]]] = []

    def number(self) -> int:
        """Return a number, greater than all before: whose is the smallest is called first."""
        return next(self._numbers)

    def set_places(self, places: int) -> None:
        """Call more at the same time, or fewer; whose turn it is keeps it."""
        self._places = places
        self._call()

    async def take(self, number: int) -> None:
        """Return when it is the turn of `number`. Who was called must `give_back`; who is cancelled before that must not."""
        turn = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (number, turn))
        self._call()
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():  # called at the same moment
                self.give_back()
            raise

    def give_back(self) -> None:
        """End a turn."""
        self._num_taken -= 1
        self._call()

    def _call(self) -> None:
        while self._waiting and self._num_taken < self._places:
            _, turn = heapq.heappop(self._waiting)
            if not turn.done():
                self._num_taken += 1
                turn.set_result(None)
