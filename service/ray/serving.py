"""Calls of Ray Serve: brings workers up, counts them, submits tasks. Blocking, in the one thread that Ray's processes are tied to."""

import hashlib
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from service.host.process_resources import num_sockets
from service.ray.cluster import SPIN_COUNT, RayCluster
from service.ray.reachability import leave_token, missing_here
from service.worker.plan import WorkerPlan

_DEPLOYMENT = "localizer"
# One computes, one more is already there when it ends: the router would take up to half a second to bring the next.
_REQUESTS_PER_REPLICA = 2
_TASK_RETRIES = 2
_HEALTH_CHECK_PERIOD_S = 1.0
_HEALTH_CHECK_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Staffing:
    """How many workers, and what each of them gets."""

    num_workers: int
    num_machines: int
    gpus_per_worker: int

    @property
    def workers_per_machine(self) -> int:
        """Return how many workers share a machine's processors."""
        return math.ceil(self.num_workers / self.num_machines)


class RayServing:
    """Workers behind one Serve application, and tasks beside them."""

    def __init__(self, cluster: RayCluster, plan: WorkerPlan, num_workers: int | None) -> None:
        """num_workers: None for one per GPU, else one per CPU socket (per node of a cluster that we joined)."""
        self._cluster = cluster
        self._plan = plan
        self._app_name = _app_name(cluster, plan)
        self._num_workers = num_workers

    def deploy(self) -> tuple[Any, Staffing]:
        """Start Serve and ask for the workers, without waiting for them; return the handle that calls them."""
        from ray import serve
        from ray.serve.schema import LoggingConfig

        from service.ray.remote import LocalizationReplica

        # Its import has given the logger a level and a handler of its own.
        logging.getLogger("ray.serve").setLevel(logging.ERROR)
        quiet = LoggingConfig(log_level="WARNING", enable_access_log=False)
        serve.start(proxy_location="Disabled", logging_config=quiet)
        staffing = self._staffing()
        deployment = serve.deployment(
            LocalizationReplica,
            name=_DEPLOYMENT,
            num_replicas=staffing.num_workers,
            max_ongoing_requests=_REQUESTS_PER_REPLICA,
            # Bounded before it reaches Serve: a retry after a worker's death must not be turned away.
            max_queued_requests=-1,
            max_replicas_per_node=None if self._cluster.is_ours or staffing.gpus_per_worker else 1,
            ray_actor_options={"num_cpus": 1, "num_gpus": staffing.gpus_per_worker, **self._environment()},
            health_check_period_s=_HEALTH_CHECK_PERIOD_S,
            health_check_timeout_s=_HEALTH_CHECK_TIMEOUT_S,
            graceful_shutdown_timeout_s=5,
            logging_config=quiet,
        )
        settings = replace(self._plan.settings, workers_per_machine=staffing.workers_per_machine)
        worker = deployment.bind(replace(self._plan, settings=settings))
        target = serve.RunTarget(worker, name=self._app_name, route_prefix=None)
        handle = serve.run_many([target], wait_for_applications_running=False)[0]
        return handle, staffing

    def unreachable(self) -> list[str]:
        """Return what machines of a cluster that we joined cannot reach, one sentence each."""
        if self._cluster.is_ours:
            return []
        import ray
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        settings = self._plan.settings
        token = leave_token(settings)
        checks = {
            node["NodeManagerAddress"]: ray.remote(num_cpus=0, max_calls=1)(missing_here)
            .options(scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False))
            .remote(settings, token)
            for node in ray.nodes()
            if node["Alive"]
        }
        return [f"machine {name}: {fault}" for name, check in checks.items() for fault in ray.get(check, timeout=60)]

    def num_running(self) -> int:
        """Return how many workers are up. Raises RuntimeError with Serve's message when they cannot start."""
        from ray import serve

        application = serve.status().applications.get(self._app_name)
        deployment = application.deployments.get(_DEPLOYMENT) if application else None
        if application is None or deployment is None:
            return 0
        running = sum(count for state, count in deployment.replica_states.items() if str(state) == "RUNNING")
        if not running and application.status == "DEPLOY_FAILED":
            raise RuntimeError(f"workers do not start: {deployment.message}")
        return int(running)

    def submit(self, task: Callable[..., Any], *arguments: Any) -> Any:
        """Run `task(plan, *arguments)` in a process of its own that ends with it; return the object reference."""
        import ray

        remote = ray.remote(
            max_calls=1,
            max_retries=_TASK_RETRIES,
            num_cpus=1,
            scheduling_strategy="DEFAULT" if self._cluster.is_ours else "SPREAD",
            **self._environment(),
        )(task)
        return remote.remote(self._plan, *arguments)

    def retire(self) -> None:
        """Take our application out of a cluster that stays; one of our own is simply stopped."""
        if not self._cluster.is_ours:
            from ray import serve

            serve.delete(self._app_name)

    def _staffing(self) -> Staffing:
        import ray

        num_gpus = int(ray.cluster_resources().get("GPU", 0))
        num_machines = len([node for node in ray.nodes() if node["Alive"]])
        wanted = self._num_workers or num_gpus or (num_sockets() if self._cluster.is_ours else num_machines)
        return Staffing(wanted, max(1, num_machines), 1 if wanted <= num_gpus else 0)

    def _environment(self) -> dict[str, Any]:
        # The processes of a cluster of our own inherit it.
        return (
            {}
            if self._cluster.is_ours
            else {"runtime_env": {"env_vars": {"MALLOC_ARENA_MAX": "2", "GOMP_SPINCOUNT": SPIN_COUNT}}}
        )


def _app_name(cluster: RayCluster, plan: WorkerPlan) -> str:
    """Return a name that a restarted service finds again, and that no other service in the same cluster has."""
    if cluster.is_ours:
        return "panoloc"
    return "panoloc-" + hashlib.sha256(plan.settings.storage_url.encode()).hexdigest()[:8]
