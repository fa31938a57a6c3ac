"""Overload: callers who ask again at once, and ten times as many callers as there are answers."""

import os
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from panoloc.lab.process_memory import family_bytes
from tests.campaign.clients import Answers
from tests.campaign.flood import Flood
from tests.campaign.outcome import Outcome, quantile
from tests.campaign.running import ready_service, tell
from tests.integration.running_service import RunningService

_QUEUE = 4
_MEASURING_S = 20.0
_TIMES = 10
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def impatient(seconds: float, num_clients: int = 40) -> Outcome:
    """Let ten times as many callers as the queue holds ask again at once, whatever `Retry-After` says."""
    return _overload(
        f"{num_clients} clients that ask again at once, a queue of {_QUEUE}",
        seconds,
        lambda flood, _: flood.of_impatient(num_clients, seconds),
    )


def newcomers(seconds: float) -> Outcome:
    """Let new callers come at ten times the rate that the service answers at."""
    return _overload(
        f"new clients at {_TIMES} times the rate of answers, a queue of {_QUEUE}",
        seconds,
        lambda flood, per_s: flood.of_newcomers(_TIMES * per_s, seconds),
    )


def _overload(part: str, seconds: float, flooded: Callable[[Flood, float], Answers]) -> Outcome:
    outcome, began = Outcome(part), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder, ThreadPoolExecutor(1) as thread:
        service, map_id = ready_service(Path(folder), queue_limit=str(_QUEUE))
        try:
            flood, measuring_s = Flood(str(service.http.base_url), map_id), min(_MEASURING_S, seconds / 3)
            alone = flood.of_impatient(1, measuring_s).seconds
            per_s = flood.of_impatient(_QUEUE, measuring_s).count(200) / measuring_s
            idle = _memory(service)
            before = _processor_s(service)
            flooding = thread.submit(flooded, flood, per_s)
            time.sleep(seconds)
            busy, after = _memory(service), _processor_s(service)
            answers = flooding.result()
        finally:
            service.stop()
    outcome.cases = len(answers.status)
    tell(outcome, answers, allowed=(429, 503, 504))
    taken = [lasted for lasted, status in zip(answers.seconds, answers.status, strict=True) if status == 200]
    refused = [lasted for lasted, status in zip(answers.seconds, answers.status, strict=True) if status == 429]
    outcome.figures |= {
        "one client p50, p99": f"{quantile(alone, 0.5):.2f} s, {quantile(alone, 0.99):.2f} s", "answers alone": f"{per_s:.2f}/s",
        "p99 of accepted": f"{quantile(taken, 0.99):.2f} s (asked {2 * quantile(alone, 0.99) * (1 + _QUEUE):.2f} s)",
        "refusals p50, p99": f"{1000 * quantile(refused, 0.5):.0f} ms, {1000 * quantile(refused, 0.99):.0f} ms",
        "refusals": f"{len(refused) / seconds:.0f}/s",
        "504 of admitted": f"{100 * answers.count(504) / max(1, len(taken) + answers.count(504)):.1f} %",
        "memory idle, busy": f"{idle / 1e6:.0f} MB, {busy / 1e6:.0f} MB",
        "processors of the HTTP process, of the clients": ", ".join(
            f"{(late - early) / seconds:.2f}" for early, late in zip(before, after, strict=True)
        ),
    }  # fmt: skip
    outcome.seconds = time.monotonic() - began
    return outcome


def _memory(service: RunningService) -> int:
    return sum(family_bytes(service.process.pid).values())


def _processor_s(service: RunningService) -> tuple[float, float]:
    """Return the processor seconds of the HTTP process and of this one, in which the clients are."""
    fields = Path(f"/proc/{service.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S, time.process_time()
