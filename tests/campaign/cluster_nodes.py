"""The kill of a node of a Ray cluster whose workers two API replicas use: Ray's processes on it and the worker, at once."""

import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.campaign.clients import Answers
from tests.campaign.outcome import Outcome
from tests.campaign.running import PATIENCE_S, tell
from tests.integration.ray_cluster import RayClusterOfOthers, start_workers
from tests.integration.real_redis import RealRedis
from tests.integration.running_service import RunningService, eventually
from tests.integration.small_room import OPTIONS, small_room

_REPLICAS = 2
_NODE = 1


def node_killed(num_queries: int = 200, num_clients: int = 4) -> Outcome:
    """Kill one of two nodes after half of the queries; any answer but 200 is a fault."""
    outcome = Outcome(f"kill one of two nodes during {num_queries} queries of {num_clients} clients")
    redis = RealRedis()
    with tempfile.TemporaryDirectory(prefix="pl-") as folder, RayClusterOfOthers(1) as cluster:
        settings = {"shared": "true", "redis_url": redis.url, "ray_address": cluster.address}
        data = Path(folder) / "data"
        start_workers(cluster.address, data, redis.url)
        replicas = [RunningService(data, **settings) for _ in range(_REPLICAS)]
        try:
            for replica in replicas:
                replica.wait_until_ready(PATIENCE_S)
            map_id = replicas[0].register(small_room().scan, OPTIONS)
            assert eventually(lambda: all(each.map(map_id).get("status") == "ready" for each in replicas), PATIENCE_S)
            began, answers, lock = time.monotonic(), Answers(), threading.Lock()

            def ask(number: int) -> None:
                asked = time.monotonic()
                reply = replicas[number % _REPLICAS].localize(small_room().panorama, map_id)
                is_right = reply.status_code == 200 and small_room().error_of(reply.json()).within(0.05, 5)
                with lock:
                    answers.at.append(time.monotonic())
                    answers.status.append(reply.status_code)
                    answers.seconds.append(time.monotonic() - asked)
                    answers.wrong += reply.status_code == 200 and not is_right
                    if len(answers.status) == num_queries // 2:
                        cluster.kill(_NODE)

            with ThreadPoolExecutor(num_clients) as clients:
                list(clients.map(ask, range(num_queries)))
        finally:
            for replica in replicas:
                replica.kill()
            redis.kill()
    outcome.cases, outcome.seconds = len(answers.status), time.monotonic() - began
    tell(outcome, answers)
    outcome.figures["longest answer"] = f"{max(answers.seconds):.1f} s"
    return outcome
