"""Kills under clients: of a worker or Redis, an API replica behind the proxy, a whole service, a node of a cluster."""

import itertools
import json
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.scan.ply.writer import encode_ply
from panoloc.lab.process_memory import command_of
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene
from panoloc.lab.rooms.suites import suite_cases
from tests.campaign.clients import Answers, Clients, Reader
from tests.campaign.outcome import Outcome, quantile
from tests.campaign.running import MAX_WAIT_S, ready_service, tell
from tests.core.image.picture_files import encoded
from tests.integration.proxy import proxy_before
from tests.integration.ray_cluster import RayClusterOfOthers, start_workers
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room

# What comes back by itself.
KILLED = {"worker": "panoloc-worker", "redis": "redis.sock"}
_REPLICAS = 3
_CAMPUS_SEED = 30_000  # of the first room
_READ_S = 2.0  # after a kill, in which a map is read again and again


def process_kills(process: str, times: int, num_clients: int = 4) -> Outcome:
    """Kill one class of processes again and again, which the service starts anew by itself."""
    outcome = Outcome(f"kill the {process} under {num_clients} clients")
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        service, map_id = ready_service(Path(folder))

        def pids() -> list[int]:
            return [pid for pid in service.family() if KILLED[process] in command_of(pid)]

        def kill(_: int) -> None:
            for pid in pids():
                os.kill(pid, signal.SIGKILL)

        def wait_for_next(_: int) -> None:
            assert eventually(lambda: bool(pids()), MAX_WAIT_S)

        try:
            clients = Clients(str(service.http.base_url), map_id, num_clients)
            killed_again(outcome, clients, times, kill, wait_for_next)
            check_map(outcome, service, map_id)
        finally:
            service.stop()
    return outcome


def check_map(outcome: Outcome, service: RunningService, map_id: str) -> None:
    """Count it as a fault where the map is no longer listed."""
    if map_id not in [each["id"] for each in service.http.get("/maps").json()["items"]]:
        outcome.faults.append("a map is lost")


def replica_kills(times: int, num_clients: int = 4) -> Outcome:
    """Kill one of three HTTP processes again and again; each is started anew before the next."""
    outcome = Outcome(f"kill one of {_REPLICAS} API replicas under {num_clients} clients")
    with RealRedis() as redis, tempfile.TemporaryDirectory(prefix="pl-") as folder:
        data, settings = Path(folder) / "data", {"shared": "true", "redis_url": redis.url}
        replicas: list[RunningService] = []
        try:
            replicas += [RunningService(data, **settings) for _ in range(_REPLICAS)]
            for replica in replicas:
                replica.wait_until_ready()
            map_id = replicas[0].register(small_room().scan, OPTIONS)

            killed_at = []

            def kill(number: int) -> None:
                killed_at.append(time.monotonic())
                os.kill(replicas[number % _REPLICAS].process.pid, signal.SIGKILL)

            def start(number: int) -> None:
                gone = replicas[number % _REPLICAS]
                gone.kill()
                replicas[number % _REPLICAS] = RunningService(data, port=str(gone.port), **settings)
                replicas[number % _REPLICAS].wait_until_ready()

            with proxy_before([f"127.0.0.1:{replica.port}" for replica in replicas], Path(folder)) as proxy:
                reader = Reader(proxy.url, f"/maps/{map_id}", proxy.context)
                clients = Clients(proxy.url, map_id, num_clients, context=proxy.context)
                try:
                    killed_again(outcome, clients, times, kill, start)
                finally:
                    reader.stop()
                without_s = [reader.longest_without_s(at, at + _READ_S) for at in killed_at]
                outcome.figures["a map is read again after (median, longest)"] = (
                    f"{quantile(without_s, 0.5):.2f} s, {max(without_s, default=0.0):.2f} s"
                )
                if reader.refused:
                    outcome.faults.append(f"a map could not be read: {reader.refused}")
        finally:
            for replica in replicas:
                replica.kill()
    return outcome


def service_kills(times: int, num_clients: int = 4) -> Outcome:
    """Kill every process of a service at once, and start it again."""
    outcome = Outcome(f"kill the whole service under {num_clients} clients")
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        service, map_id = ready_service(Path(folder))
        running = [service]

        def kill(_: int) -> None:
            running[0].kill()
            running[0] = RunningService(Path(folder) / "data", port=str(service.port))

        try:
            clients = Clients(str(service.http.base_url), map_id, num_clients)
            killed_again(outcome, clients, times, kill, lambda _: None, allowed=(0, 503))
            check_map(outcome, running[0], map_id)
        finally:
            running[0].kill()
    return outcome


def node_killed(num_queries: int = 200, num_clients: int = 4) -> Outcome:
    """Kill one of two nodes after half of the queries; any answer but 200 is a fault."""
    outcome = Outcome(f"kill one of two nodes during {num_queries} queries of {num_clients} clients")
    with RealRedis() as redis, tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(1) as cluster:
        settings = {"shared": "true", "redis_url": redis.url, "ray_address": cluster.address}
        data = Path(folder) / "data"
        start_workers(cluster.address, data, redis.url)
        replicas = [RunningService(data, **settings) for _ in range(2)]
        try:
            for replica in replicas:
                replica.wait_until_ready(MAX_WAIT_S)
            map_id = replicas[0].register(small_room().scan, OPTIONS)
            assert eventually(lambda: all(each.map(map_id).get("status") == "ready" for each in replicas), MAX_WAIT_S)

            def ask(number: int) -> tuple[int, bool]:
                reply = replicas[number % 2].localize(small_room().panorama, map_id)
                is_right = reply.status_code == 200 and small_room().error_of(reply.json()).within(0.05, 5)
                return reply.status_code, is_right

            _asked_while_one_dies(outcome, ask, num_queries, num_clients, lambda: cluster.kill(1))
        finally:
            for replica in replicas:
                replica.kill()
    return outcome


def node_of_campus_killed(num_maps: int = 300, num_queries: int = 50, num_clients: int = 2) -> Outcome:
    """Kill one of three nodes after half of the queries over all maps, of which each node holds a share; each is asked in a changed room of
    its own. Any answer but 200 is a fault, and every answer in a wrong map or pose."""
    outcome = Outcome(f"kill one of three nodes during {num_queries} queries over {num_maps} maps")
    with RealRedis() as redis, tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(2) as cluster:
        data = Path(folder) / "data"
        start_workers(cluster.address, data, redis.url)
        settings = {"shared": "true", "redis_url": redis.url, "ray_address": cluster.address, "num_registrations": "3"}
        service = RunningService(data, **settings)
        try:
            service.wait_until_ready(MAX_WAIT_S)
            ids = []
            for number in range(num_maps):
                scan = encode_ply(scan_scene(build_scene(SceneSpec("room", _CAMPUS_SEED + number)), num_points=60_000))
                form = {"options": json.dumps({"tags": ["campus"], "name": f"room {number}"})}
                answer = service.http.post("/maps", files={"file": (f"{number}.ply", scan)}, data=form)
                assert answer.status_code == 202, answer.text
                ids.append(str(answer.json()["id"]))
            uploaded, num_localized = time.monotonic(), itertools.count()
            assert eventually(lambda: all(service.map(each)["status"] == "ready" for each in ids), 30 * num_maps)
            outcome.figures["registrations after the last upload"] = f"{time.monotonic() - uploaded:.0f} s"

            def ask(number: int) -> tuple[int, bool]:
                place = number * num_maps // num_queries
                (case,) = suite_cases("changed", [_CAMPUS_SEED + place], num_points=20_000)
                image = ("image", ("0.jpg", encoded(case.query.photos[0].color, "JPEG", quality=92), "image/jpeg"))
                form = {"tag": "campus", "options": json.dumps({"timeout_s": 500})}
                reply = service.http.post("/localize", files=[image], data=form)
                if reply.status_code != 200:
                    return reply.status_code, False
                found = reply.json()
                if found["status"] != "localized":
                    return 200, True
                next(num_localized)
                pose = np.array(found["pose"]["map_from_camera"]["matrix"])
                error = pose_error(Pose(pose[:3, :3], pose[:3, 3]), case.pose)
                return 200, found["map_id"] == ids[place] and error.within(0.3, 10)

            _asked_while_one_dies(outcome, ask, num_queries, num_clients, lambda: cluster.kill(1))
            outcome.figures["localized"] = str(next(num_localized))
        finally:
            service.kill()
    return outcome


def _asked_while_one_dies(
    outcome: Outcome,
    ask: Callable[[int], tuple[int, bool]],
    num_queries: int,
    num_clients: int,
    kill: Callable[[], None],
) -> None:
    """Ask with several clients, and kill once half of the answers are there. ask: returns status, and whether the answer is right."""
    began, answers, lock = time.monotonic(), Answers(), threading.Lock()

    def one(number: int) -> None:
        asked = time.monotonic()
        status, is_right = ask(number)
        with lock:
            answers.at.append(time.monotonic())
            answers.status.append(status)
            answers.seconds.append(time.monotonic() - asked)
            answers.wrong += status == 200 and not is_right
            if len(answers.status) == num_queries // 2:
                kill()

    with ThreadPoolExecutor(num_clients) as clients:
        list(clients.map(one, range(num_queries)))
    outcome.cases, outcome.seconds = len(answers.status), time.monotonic() - began
    tell(outcome, answers)
    outcome.figures["longest answer"] = f"{max(answers.seconds):.1f} s"


def killed_again(
    outcome: Outcome,
    clients: Clients,
    times: int,
    kill: Callable[[int], None],
    start: Callable[[int], None],
    allowed: tuple[int, ...] = (),
) -> None:
    """Kill under clients, wait for the next answer, start what is gone, and so on; say what came of it."""
    began, back_s, without_s = time.monotonic(), [], []
    try:
        for number in range(times):
            # Clients that were paused ask all at once: of that, too, the first answer takes its time.
            asked = time.monotonic()
            assert eventually(lambda since=asked: clients.num_answered_since(since) > 2 * clients.number, MAX_WAIT_S)  # type: ignore[misc]
            without_s.append(_next_answer_s(clients, lambda: None))
            back_s.append(_next_answer_s(clients, lambda: kill(number)))  # noqa: B023
            start(number)
            outcome.cases += 1
    finally:
        answers = clients.stop()
    tell(outcome, answers, allowed)
    outcome.figures |= {
        "answers flow again after (median, longest)": f"{quantile(back_s, 0.5):.1f} s, {max(back_s, default=0.0):.1f} s",
        "the same without a kill": f"{quantile(without_s, 0.5):.1f} s, {max(without_s, default=0.0):.1f} s",
    }
    outcome.seconds = time.monotonic() - began


def _next_answer_s(clients: Clients, happens: Callable[[], None]) -> float:
    """Let something happen, and return the seconds to the next answer; those that were on their way do not count."""
    began = time.monotonic()
    happens()
    assert eventually(lambda: clients.answered_since(began + 0.2), MAX_WAIT_S)
    return time.monotonic() - began
