"""Ray that does not start, or is not there, is found out elsewhere, while this process goes on."""

import asyncio
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from service.host.lifeline import Lifeline
from service.ray.own_node import OwnNode
from service.ray.rehearsal import rehearse

pytestmark = pytest.mark.slow

# Ray's own attempts hold the interpreter for 20 to 30 s.
LONG_S = 10


async def longest_silence_s(fails: Callable[[], object], message: str) -> float:
    trying = asyncio.create_task(asyncio.to_thread(fails))
    longest_s, last = 0.0, time.monotonic()
    while not trying.done():
        await asyncio.sleep(0.02)
        longest_s, last = max(longest_s, time.monotonic() - last), time.monotonic()
    with pytest.raises(RuntimeError, match=message):
        await trying
    return longest_s


def test_the_event_loop_is_never_silent_while_ray_does_not_start(tmp_path: Path) -> None:
    in_the_way = tmp_path / "ray"
    in_the_way.write_text("a file where Ray wants a folder")
    node = OwnNode(in_the_way)
    try:
        assert asyncio.run(longest_silence_s(node.address, "Ray does not start: .*Error")) < LONG_S
    finally:
        node.end()


def test_the_event_loop_is_never_silent_while_a_cluster_cannot_be_joined() -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{nobody.getsockname()[1]}"
        lifeline = Lifeline()
        try:
            assert asyncio.run(longest_silence_s(lambda: rehearse(address, lifeline), "Ray cannot be joined")) < LONG_S
        finally:
            lifeline.close()
