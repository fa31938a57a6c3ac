"""Who is called when, from one event loop."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from service.ray.queue.turns import Turns


def run(scenario: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(scenario, 20))


async def settled() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


class Callers:
    """Tasks that wait for their turn, and who was called, in order."""

    def __init__(self, turns: Turns) -> None:
        self.turns = turns
        self.called: list[int] = []
        self.tasks: dict[int, asyncio.Task[None]] = {}

    def come(self, *numbers: int) -> None:
        for number in numbers:
            self.tasks[number] = asyncio.ensure_future(self._take(number))

    async def _take(self, number: int) -> None:
        await self.turns.take(number)
        self.called.append(number)


def test_as_many_as_there_are_places_have_their_turn_and_then_whose_number_is_smallest() -> None:
    async def scenario() -> None:
        callers = Callers(Turns(2))
        callers.come(4, 7, 9, 6, 8)
        await settled()
        assert callers.called == [4, 7]
        for _ in range(3):
            callers.turns.give_back()
            await settled()
        assert callers.called == [4, 7, 6, 8, 9]

    run(scenario())


def test_numbers_grow() -> None:
    turns = Turns(1)
    numbers = [turns.number() for _ in range(5)]
    assert numbers == sorted(set(numbers))


def test_who_stops_waiting_is_passed_over() -> None:
    async def scenario() -> None:
        callers = Callers(Turns(1))
        callers.come(0, 1, 2)
        await settled()
        callers.tasks[1].cancel()
        await settled()
        callers.turns.give_back()
        await settled()
        assert callers.called == [0, 2]

    run(scenario())


def test_who_is_cancelled_as_he_is_called_leaves_his_turn_to_the_next() -> None:
    async def scenario() -> None:
        callers = Callers(Turns(1))
        callers.come(0, 1, 2)
        await settled()
        callers.turns.give_back()
        callers.tasks[1].cancel()  # called, but not awake yet
        await settled()
        assert callers.called == [0, 2]
        callers.turns.give_back()
        callers.come(3)
        await settled()
        assert callers.called == [0, 2, 3]

    run(scenario())


def test_new_places_are_taken_at_once_and_places_that_go_are_not_taken_again() -> None:
    async def scenario() -> None:
        callers = Callers(Turns(1))
        callers.come(*range(6))
        await settled()
        callers.turns.set_places(3)
        await settled()
        assert callers.called == [0, 1, 2]
        callers.turns.set_places(1)
        callers.turns.give_back()
        callers.turns.give_back()
        await settled()
        assert callers.called == [0, 1, 2]
        callers.turns.give_back()
        await settled()
        assert callers.called == [0, 1, 2, 3]

    run(scenario())


@given(
    places=st.integers(1, 4), steps=st.lists(st.sampled_from(["come", "end", "leave", "end and leave"]), max_size=40)
)
def test_no_place_is_lost_and_none_is_taken_twice(places: int, steps: list[str]) -> None:
    async def scenario() -> None:
        callers, given_back, number = Callers(Turns(places)), 0, 0
        for step in steps:
            waiting = [task for task in callers.tasks.values() if not task.done()]
            if step == "come":
                callers.come(number)
                number += 1
            if "end" in step and len(callers.called) > given_back:
                callers.turns.give_back()
                given_back += 1
            if "leave" in step and waiting:
                waiting[0].cancel()
            await settled()
            num_waiting = sum(not task.done() for task in callers.tasks.values())
            num_having = len(callers.called) - given_back
            assert num_having == places or (num_having < places and not num_waiting)
            assert callers.called == sorted(callers.called)
        for task in callers.tasks.values():
            task.cancel()

    run(scenario())
