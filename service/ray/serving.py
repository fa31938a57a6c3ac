"""Calls of Ray Serve: brings workers up, counts them, submits tasks. Blocking, in the one thread that Ray's processes are tied to."""

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from service.errors import NoWorkerError
from service.host.process_resources import SPINNING, num_sockets
from service.host.service_version import service_version
from service.ray.cluster import RayCluster
from service.ray.front_doors import FrontDoors
from service.ray.queue.admission import REQUESTS_PER_WORKER
from service.ray.reachability import leave_token, missing_here, take_token_back
from service.worker.plan import WorkerPlan

_log = logging.getLogger(__name__)

_DEPLOYMENT = "localizer"
_TASK_RETRIES = 2
_LONGEST_TOLD = 400
_MACHINE_S = 60.0
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
    """Workers behind one Serve application, and tasks beside them. told: what Serve says of those that are not up, "" for nothing."""

    def __init__(
        self, cluster: RayCluster, plan: WorkerPlan, num_workers: int | None, front_doors: FrontDoors | None = None
    ) -> None:
        """num_workers: None for one per GPU, else one per CPU socket (per node of a cluster that we joined).

        front_doors: of a cluster that we joined, None for one of our own.
        """
        self._cluster = cluster
        self._plan = plan
        self._front_doors = front_doors
        self._app_name = front_doors.application if front_doors is not None else "panoloc"
        self._num_workers = num_workers
        self._num_asked_for: int | None = None
        self.told = ""

    def deploy(self) -> tuple[Any, Staffing] | None:
        """Start Serve and ask for the workers, without waiting for them; return the handle that calls them.

        Where another front door has done so, or is about to, its workers are used; None until they are there.
        """
        _quieten_serve()
        staffing = self._staffing()
        if self._front_doors is not None and self._front_doors.senior() is not None:
            handle = _handle_of(self._app_name)
            return None if handle is None else (handle, staffing)
        if self._front_doors is not None:
            self._say_who_differs(self._front_doors)
        return self._deployed(staffing), staffing

    def follow_machines(self) -> None:
        """Ask for more or fewer workers where a cluster that we joined has other machines than before; of several front doors one does."""
        if self._front_doors is None or self._num_workers is not None or self._front_doors.senior() is not None:
            return
        staffing = self._staffing()
        if staffing.num_workers != self._num_asked_for:
            self._deployed(staffing)

    def _deployed(self, staffing: Staffing) -> Any:
        from ray import serve
        from ray.serve.schema import LoggingConfig

        from service.ray.remote import LocalizationReplica

        quiet = LoggingConfig(log_level="WARNING", enable_access_log=False)
        serve.start(proxy_location="Disabled", logging_config=quiet)
        self._remove_abandoned()
        deployment = serve.deployment(
            LocalizationReplica,
            name=_DEPLOYMENT,
            num_replicas=staffing.num_workers,
            max_ongoing_requests=REQUESTS_PER_WORKER,
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
        if self._front_doors is not None:
            # Otherwise each call would replace the workers that are there. Only Serve itself may name versions, says Serve.
            deployment = deployment.options(version=self._app_name, _internal=True)
        worker = deployment.bind(replace(self._plan, settings=settings))
        target = serve.RunTarget(worker, name=self._app_name, route_prefix=None)
        handle = serve.run_many([target], wait_for_applications_running=False)[0]
        self._num_asked_for = staffing.num_workers
        return handle

    def unreachable(self) -> list[str]:
        """Return what machines of a cluster that we joined cannot reach, one sentence each."""
        if self._cluster.is_ours:
            return []
        import ray
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        settings = self._plan.settings
        token = leave_token(settings)
        checks = {
            (node["NodeManagerAddress"], node["NodeID"]): ray.remote(num_cpus=0, max_calls=1)(missing_here)
            .options(scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False))
            .remote(settings, token, service_version())
            for node in ray.nodes()
            if node["Alive"]
        }
        try:
            found = [(name, self._cluster.patience.gotten(check, _MACHINE_S)) for (name, _), check in checks.items()]
        finally:
            take_token_back(settings, token)
        return [f"machine {name}: {fault}" for name, faults in found for fault in faults]

    def num_running(self) -> int:
        """Return how many workers are up. Raises RuntimeError with Serve's message when they cannot start."""
        application = self._applications().get(self._app_name)
        deployment = application.deployments.get(_DEPLOYMENT) if application else None
        if application is None or deployment is None:
            if self._front_doors is not None:
                raise NoWorkerError(f"the application {self._app_name} was taken out of Ray Serve")
            return 0
        self.told = " ".join(deployment.message.split())[:_LONGEST_TOLD]
        running = sum(count for state, count in deployment.replica_states.items() if str(state) == "RUNNING")
        if not running and application.status == "DEPLOY_FAILED":
            raise RuntimeError(f"workers do not start: {deployment.message}")
        return int(running)

    def exchange_load(self, num_admitted: int) -> list[int]:
        """Tell other front doors how many queries are under way here; return how many are at each of those that use our workers."""
        return [] if self._front_doors is None else self._front_doors.exchange_load(num_admitted)

    def _applications(self) -> Mapping[str, Any]:
        """Return what `serve.status` would, which waits for ever where there is no cluster any more."""
        from ray.serve.context import _get_global_client
        from ray.serve.schema import ServeInstanceDetails

        client = _get_global_client(raise_if_no_controller_running=False)
        if client is None:
            return {}
        details = self._cluster.patience.gotten(client._controller.get_serve_instance_details.remote())
        found: Mapping[str, Any] = ServeInstanceDetails(**details)._get_status().applications
        return found

    def submit(self, task: Callable[..., Any], *arguments: Any) -> Any:
        """Run `task(plan, *arguments)` in a process of its own that ends with it; return the object reference."""
        import ray

        from service.ray.remote import register_map

        remote = ray.remote(
            max_calls=1,
            # Those who register count the attempts themselves, in the record of the map.
            max_retries=0 if task is register_map else _TASK_RETRIES,
            num_cpus=1,
            scheduling_strategy="DEFAULT" if self._cluster.is_ours else "SPREAD",
            **self._environment(),
        )(task)
        return remote.remote(self._plan, *arguments)

    def retire(self) -> None:
        """Take our application out of a cluster that stays, unless others use it; one of our own is simply stopped."""
        if self._front_doors is not None:
            from ray import serve

            self._front_doors.say_leaving()
            if self._front_doors.are_alone():
                serve.delete(self._app_name)

    def _remove_abandoned(self) -> None:
        """Remove the workers of front doors that were killed and have not come back as they were."""
        if self._front_doors is None:
            return
        from ray import serve

        for name in self._front_doors.abandoned(list(self._applications())):
            _log.warning("removing workers that no front door uses any more", extra={"application": name})
            serve.delete(name, _blocking=False)

    def _say_who_differs(self, front_doors: FrontDoors) -> None:
        for difference in front_doors.differing():
            _log.warning(
                "another front door on this data folder has another configuration or version, so this one brings up workers of its own; "
                "set both alike, or let the other one end",
                extra={"other": difference},
            )

    def _staffing(self) -> Staffing:
        import ray

        num_gpus = int(ray.cluster_resources().get("GPU", 0))
        # One without a processor to give is there for its front door, or is the head alone.
        num_machines = sum(node["Alive"] and node["Resources"].get("CPU", 0) >= 1 for node in ray.nodes())
        wanted = self._num_workers or num_gpus or (num_sockets() if self._cluster.is_ours else max(1, num_machines))
        return Staffing(wanted, max(1, num_machines), 1 if wanted <= num_gpus else 0)

    def _environment(self) -> dict[str, Any]:
        # The processes of a cluster of our own inherit it.
        return {} if self._cluster.is_ours else {"runtime_env": {"env_vars": {"MALLOC_ARENA_MAX": "2", **SPINNING}}}


def _quieten_serve() -> None:
    from ray import serve  # noqa: F401

    # Its import has given the logger a level and a handler of its own.
    logging.getLogger("ray.serve").setLevel(logging.ERROR)


def _handle_of(app_name: str) -> Any:
    """Return what calls the workers of an application that somebody else has brought up, None where it is not there yet."""
    from ray import serve
    from ray.serve.exceptions import RayServeException

    try:
        return serve.get_app_handle(app_name)
    except RayServeException:
        return None
