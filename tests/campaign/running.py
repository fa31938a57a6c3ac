"""Kills and soak of a service that runs as its users run it."""

import os
import signal
import tempfile
import time
from collections import Counter
from pathlib import Path

import redis

from panoloc.lab.process_memory import command_of, family_bytes
from tests.campaign.clients import Answers, Clients
from tests.campaign.outcome import Outcome, quantile
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room

# What comes back by itself.
KILLED = {"worker": "panoloc.service.pool.child", "redis": "redis.sock"}
PATIENCE_S = 300.0


def kills(process: str, times: int, num_clients: int = 4) -> Outcome:
    """Kill one class of processes again and again under clients."""
    outcome, began = Outcome(f"kill the {process} under {num_clients} clients"), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        service, map_id = ready_service(Path(folder))
        clients = Clients(str(service.http.base_url), map_id, num_clients)
        back_s = []
        try:
            assert eventually(lambda: clients.answered_since(0.0), PATIENCE_S)
            for _ in range(times):
                assert eventually(lambda: bool(_pids(service, process)), PATIENCE_S)
                killed = time.monotonic()
                for pid in _pids(service, process):
                    os.kill(pid, signal.SIGKILL)
                # Answers that were on their way when it was killed do not count.
                time.sleep(0.2)
                assert eventually(lambda since=killed + 0.2: clients.answered_since(since), PATIENCE_S)  # type: ignore[misc]
                back_s.append(time.monotonic() - killed)
                outcome.cases += 1
            answers = clients.stop()
            if service.http.get("/maps").json()["items"][0]["id"] != map_id:
                outcome.faults.append("a map is lost")
        finally:
            clients.stop()
            service.stop()
    tell(outcome, answers)
    outcome.figures |= {
        "answers flow again after (median, longest)": f"{quantile(back_s, 0.5):.1f} s, {max(back_s):.1f} s"
    }
    outcome.seconds = time.monotonic() - began
    return outcome


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


def _pids(service: RunningService, process: str) -> list[int]:
    return [pid for pid in service.family() if KILLED[process] in command_of(pid)]


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
