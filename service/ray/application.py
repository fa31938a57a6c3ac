"""The workers as one declared Ray Serve application: `panoloc workers`, `serve deploy` or KubeRay's RayService bring it up.

The import path of a Serve config is `panoloc.service.ray.application:workers`. Settings come from `PANOLOC_` variables
where the config is built.
"""

import asyncio
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import ray
from ray import serve
from ray.serve.handle import DeploymentHandle
from ray.serve.schema import LoggingConfig

from panoloc.service.host.process_resources import SPINNING, return_freed_memory
from panoloc.service.jobs import LocalizeJob, LocalizeOutcome
from panoloc.service.pool.forked_process import ForkServer
from panoloc.service.pool.messages import Build
from panoloc.service.pool.worker_process import OVERDUE_S, run_build
from panoloc.service.settings import Settings
from panoloc.service.worker.plan import WorkerPlan, WorkerReply

APPLICATION, LOCALIZER, BUILDER = "panoloc", "localizer", "builder"
"""The names under which API replicas find the application and its two deployments."""

REQUESTS_PER_WORKER = 2
"""One computes and the next one is already there: Ray Serve takes a moment to bring it."""

_MAPS_KNOWN_TO_ROUTER = 1000
_BUILDS_PER_MACHINE = 8
_IDLE_S = 1.0
_HEALTH_CHECK_PERIOD_S, _HEALTH_CHECK_TIMEOUT_S = 1.0, 30.0
_QUIET = LoggingConfig(log_level="WARNING", enable_access_log=False)


class Localizer:
    """One worker. Computes one query at a time, with all the threads it was given."""

    def __init__(self, plan: WorkerPlan, builder: DeploymentHandle) -> None:
        """builder: named so that both deployments are one application."""
        self._plan = plan
        # One thread builds the worker and computes: OpenMP keeps a team of threads for each thread that asks.
        self._computing = ThreadPoolExecutor(max_workers=1, thread_name_prefix="compute")
        self._worker = self._computing.submit(plan.build_worker).result()
        self._due_unix_s: float | None = None
        self._num_under_way = 0

    async def localize(self, job: LocalizeJob) -> WorkerReply[LocalizeOutcome]:
        """Answer one query after the ones that came before it."""
        await self._mark_resident(serve.get_multiplexed_model_id())
        loop = asyncio.get_running_loop()
        self._num_under_way += 1
        is_cancelled = threading.Event()
        try:
            return await loop.run_in_executor(self._computing, self._compute, job, is_cancelled.is_set)
        except asyncio.CancelledError:
            is_cancelled.set()
            raise
        finally:
            self._num_under_way -= 1
            loop.call_later(_IDLE_S, self._tidy_when_idle)

    async def describe(self) -> dict[str, str]:
        """Return what an API replica must have in common with this worker."""
        return description(self._plan)

    def check_health(self) -> None:
        """Raise when the query under way should have ended long ago; Serve then replaces this replica."""
        due = self._due_unix_s
        if due is not None and time.time() > due + OVERDUE_S:
            raise RuntimeError(f"a query is {time.time() - due:.0f} s past its deadline")

    @serve.multiplexed(max_num_models_per_replica=_MAPS_KNOWN_TO_ROUTER)  # type: ignore[untyped-decorator]
    async def _mark_resident(self, map_id: str) -> str:
        # Only tells the router where a map was asked for, so that the next query goes there as well.
        return map_id

    def _tidy_when_idle(self) -> None:
        if not self._num_under_way:
            self._computing.submit(return_freed_memory)

    def _compute(self, job: LocalizeJob, is_cancelled: Callable[[], bool]) -> WorkerReply[LocalizeOutcome]:
        self._due_unix_s = job.deadline_unix_s
        try:
            return self._worker.localize(job, is_cancelled)
        finally:
            self._due_unix_s = None


class Builder:
    """Runs each build in a process of its own on its machine, which ends when the call is cancelled."""

    def __init__(self, plan: WorkerPlan) -> None:
        self._plan = plan
        self._fork_server = ForkServer(plan.modules)

    async def build(self, job: Build) -> WorkerReply[Any]:
        """Run one registration or rebuild. Raises NoWorkerError when its process dies."""
        return await run_build(self._plan, job, self._fork_server)


def description(plan: WorkerPlan) -> dict[str, str]:
    """Return what workers and API replicas must have in common, without passwords."""
    return {
        "version": version("panoloc"),
        "PANOLOC_REDIS_URL": plan.redis_url.rpartition("@")[2],
        "PANOLOC_DATA_DIR or PANOLOC_STORAGE": plan.storage_url,
    }


def workers(arguments: dict[str, str]) -> serve.Application:
    """Return the application for the cluster that runs this; the import path of a Serve config.

    arguments: `num_workers`, where it is not to be one per GPU or, without GPUs, one per machine.
    """
    return application(plan_of_environment(), arguments.get("num_workers"))


def plan_of_environment() -> WorkerPlan:
    """Return the plan that the settings of this process say. Raises ValueError without a Redis, or with wrong settings."""
    settings = Settings()
    if settings.redis_url is None:
        raise ValueError("expected PANOLOC_REDIS_URL with a Redis that all machines reach, but it is not set")
    return WorkerPlan.of(settings, settings.redis_url)


def application(plan: WorkerPlan, num_workers: int | str | None = None) -> serve.Application:
    """Return the application that runs a plan; see `workers`."""
    num_gpus = int(ray.cluster_resources().get("GPU", 0))
    num_machines = sum(node["Alive"] and node["Resources"].get("CPU", 0) >= 1 for node in ray.nodes()) or 1
    wanted = int(num_workers or num_gpus or num_machines)
    has_gpu = wanted <= num_gpus
    shared = replace(plan, workers_per_machine=math.ceil(wanted / num_machines))
    common = {
        "max_queued_requests": -1,
        "health_check_period_s": _HEALTH_CHECK_PERIOD_S,
        "health_check_timeout_s": _HEALTH_CHECK_TIMEOUT_S,
        "graceful_shutdown_timeout_s": 5,
        "logging_config": _QUIET,
    }
    environment = {"runtime_env": {"env_vars": {"MALLOC_ARENA_MAX": "2", **SPINNING}}}
    localizer = serve.deployment(
        Localizer,
        name=LOCALIZER,
        num_replicas=wanted,
        max_ongoing_requests=REQUESTS_PER_WORKER,
        ray_actor_options={"num_cpus": 1, "num_gpus": int(has_gpu), **environment},
        **common,
    )
    builder = serve.deployment(
        Builder,
        name=BUILDER,
        num_replicas=num_machines,
        max_replicas_per_node=1,
        max_ongoing_requests=_BUILDS_PER_MACHINE,
        ray_actor_options={"num_cpus": 0, **environment},
        **common,
    )
    return localizer.bind(shared, builder.bind(plan))


def deploy(address: str, plan: WorkerPlan, num_workers: int | None = None) -> int:
    """Bring the application up on a running cluster, or change it, and return the number of workers once they are up.

    Raises what Ray raises: ConnectionError where nothing listens, RuntimeError when workers do not start.
    """
    ray.init(address=address, namespace=APPLICATION, log_to_driver=False, logging_level="ERROR")
    try:
        serve.start(proxy_location="Disabled", logging_config=_QUIET)
        serve.run(application(plan, num_workers), name=APPLICATION, route_prefix=None)
        return num_running()
    finally:
        ray.shutdown()


def num_running() -> int:
    """Return how many workers are up."""
    found = serve.status().applications.get(APPLICATION)
    states = found.deployments[LOCALIZER].replica_states if found and LOCALIZER in found.deployments else {}
    return sum(count for state, count in states.items() if str(state) == "RUNNING")
