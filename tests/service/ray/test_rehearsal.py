"""Ray that does not start is found out elsewhere, while this process goes on."""

import asyncio
import time
from pathlib import Path

import pytest

from service.host.lifeline import Lifeline
from service.ray.rehearsal import rehearse


@pytest.mark.slow
def test_the_event_loop_is_never_silent_while_ray_does_not_start(tmp_path: Path) -> None:
    in_the_way = tmp_path / "try"
    in_the_way.write_text("a file where Ray wants a folder")
    lifeline = Lifeline()

    async def longest_silence_s() -> float:
        trying = asyncio.create_task(asyncio.to_thread(rehearse, None, in_the_way, lifeline))
        longest_s, last = 0.0, time.monotonic()
        while not trying.done():
            await asyncio.sleep(0.02)
            longest_s, last = max(longest_s, time.monotonic() - last), time.monotonic()
        with pytest.raises(RuntimeError, match="Ray does not start"):
            await trying
        return longest_s

    try:
        assert asyncio.run(longest_silence_s()) < 2
    finally:
        lifeline.close()
