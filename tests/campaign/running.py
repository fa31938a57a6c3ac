"""A soak of a service that runs as its users run it, and what all parts with a service share."""

import os
import tempfile
import time
from collections import Counter
from pathlib import Path

import redis

from panoloc.lab.process_memory import family_bytes
from tests.campaign.clients import Answers, Clients
from tests.campaign.outcome import Outcome
from tests.integration.running_service import RunningService
from tests.integration.small_room import OPTIONS, small_room

MAX_WAIT_S = 300.0


def soak(seconds: float) -> Outcome:
    """Ask without a pause; compare memory, descriptors, files and keys of Redis at the end with those after a sixth of the time."""
    outcome, began = Outcome("soak with 2 clients"), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        # Answers are kept for a while: as many go as come by then, at the rate of each time.
        kept_s = max(1, int(seconds / 6))
        service, map_id = ready_service(Path(folder), result_ttl_s=str(kept_s))
        try:
            clients = Clients(str(service.http.base_url), map_id, 2)
            time.sleep(seconds / 6)
            first = _held(service, Path(folder), clients.num_answered_since(time.monotonic() - kept_s))
            time.sleep(seconds * 5 / 6)
            last = _held(service, Path(folder), clients.num_answered_since(time.monotonic() - kept_s))
            answers = clients.stop()
        finally:
            service.stop()
    outcome.cases = len(answers.status)
    tell(outcome, answers)
    for name, before in first.items():
        outcome.figures[name] = f"{before:,} → {last[name]:,}"
        if last[name] > 1.05 * before + 20:
            outcome.faults.append(f"{name} grew from {before:,} to {last[name]:,}")
    outcome.seconds = time.monotonic() - began
    return outcome


def ready_service(folder: Path, **settings: str) -> tuple[RunningService, str]:
    """Start a service, register a room, and return the id of its map."""
    service = RunningService(folder / "data", **settings)
    try:
        service.wait_until_ready()
        return service, service.register(small_room().scan, OPTIONS)
    except BaseException:
        service.kill()
        raise


def tell(outcome: Outcome, answers: Answers, allowed: tuple[int, ...] = ()) -> None:
    """Count the answers by status; any but 200 and what is allowed is a fault. 0: no answer."""
    statuses = Counter(answers.status)
    outcome.figures |= {
        "answers": f"{len(answers.status):,}",
        "of them 200": f"{statuses[200]:,}",
        "wrong": str(answers.wrong),
    }
    for status, count in sorted(statuses.items()):
        if status != 200:
            outcome.figures["unanswered" if status == 0 else str(status)] = f"{count:,}"
        if status != 200 and status not in allowed:
            outcome.faults.append(f"{count} requests " + ("without an answer" if status == 0 else f"with {status}"))
    if answers.wrong:
        outcome.faults.append(f"{answers.wrong} wrong poses")


def _held(service: RunningService, folder: Path, num_kept: int) -> dict[str, int]:
    """Count what a service holds. num_kept: answers that have not expired."""
    pids = service.family()
    return {
        "MB": sum(family_bytes(service.process.pid).values()) // 10**6,
        "descriptors": sum(
            len(list(Path(f"/proc/{pid}/fd").iterdir())) for pid in pids if Path(f"/proc/{pid}/fd").exists()
        ),
        "files": sum(len(names) for _, _, names in os.walk(folder)),  # what goes while they are counted does not matter
        "processes": len(pids),
        "Redis keys of 100 answers": round(100 * _num_keys(folder / "data" / "run" / "redis.sock") / max(1, num_kept)),
    }


def _num_keys(socket: Path) -> int:
    with redis.Redis(unix_socket_path=str(socket)) as client:
        return int(client.dbsize())
