"""Ray itself: a small local cluster of our own, or somebody's that we join.

Everything here blocks and has to run in one thread that lives as long as the cluster: Ray ties its processes to the
thread that started them (a parent-death signal belongs to a thread, not to a process).
"""

import contextlib
import logging
import os
import secrets
import time
from pathlib import Path
from typing import Any

from service.host.lifeline import Lifeline
from service.host.process_tree import descendants, process_name
from service.ray.ended_logs import remove_logs_of_ended
from service.ray.rehearsal import rehearse

_log = logging.getLogger(__name__)

# Panoramas and pictures in flight; what does not fit goes to disk.
_OBJECT_STORE_BYTES = 128 * 2**20
_NAMESPACE = "panoloc"

# Read by Ray's processes when they start. `setdefault`: an operator's own value wins.
SPIN_COUNT = "5000"
_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # No idle Python process (47 MB each) waits for work: a worker starts when there is work for it.
    "RAY_prestart_worker_first_driver": "0",
    "RAY_enable_worker_prestart": "0",
    "RAY_num_workers_soft_limit": "0",
    # Nobody looks at Ray's own dashboard: without these, its tables grow with every request.
    "RAY_task_events_report_interval_ms": "0",
    "RAY_enable_metrics_collection": "0",
    "RAY_SERVE_LOG_TO_STDERR": "0",
    # Of each of Ray's log files, of which there are about thirty.
    "RAY_ROTATION_MAX_BYTES": str(2**20),
    "RAY_ROTATION_BACKUP_COUNT": "1",
    # Ray would run every worker at niceness 15; only registrations give way to the others here.
    "RAY_worker_niceness": "0",
    # Ray's handler of SIGTERM sets an alarm that aborts the process three seconds later, in the middle of a drain.
    "RAY_DISABLE_FAILURE_SIGNAL_HANDLER": "1",
    # A scan that does not fit into memory once will not fit the next time.
    "RAY_task_oom_retries": "1",
    # glibc keeps freed panoramas in up to eight heaps per core otherwise.
    "MALLOC_ARENA_MAX": "2",
    # How long threads of torch that wait for each other spin before they sleep: OpenMP's own milliseconds starve everybody where
    # other work wants the cores, and to sleep at once makes a query 1.7 times as long where none does.
    "GOMP_SPINCOUNT": SPIN_COUNT,
}


class RayCluster:
    """A connection to Ray: `connect`, use, `disconnect`, all in the same thread."""

    def __init__(self, address: str | None, folder: Path, lifeline: Lifeline) -> None:
        """address: None for a cluster of our own; folder: short path for its sockets and logs."""
        self._address = address
        self._folder = folder
        self._lifeline = lifeline
        self._guarded: dict[int, str] = {}

    @property
    def is_ours(self) -> bool:
        """Tell whether the cluster ends with the service."""
        return self._address is None

    def connect(self) -> None:
        """Start or join; 3 to 10 s. Raises whatever Ray raises (ConnectionError, RuntimeError, ValueError)."""
        make_record = logging.getLogRecordFactory()
        ray = _import_ray()
        try:
            self._init(ray)
        finally:
            # Ray adds a field of its own to every log record of the process.
            logging.setLogRecordFactory(make_record)

    def _init(self, ray: Any) -> None:
        quiet: dict[str, Any] = {
            "namespace": _NAMESPACE, "log_to_driver": False, "logging_level": logging.ERROR,
            "configure_logging": False, "ignore_reinit_error": True,
        }  # fmt: skip
        if self._address is not None:
            ray.init(address=self._address, **quiet)
            return
        _choose_token()
        _stay_on_loopback()
        _start_only_what_is_needed()
        ray.init(
            address="local",
            _node_ip_address="127.0.0.1",
            # Logical: a worker, a registration and a rebuild have to find a place on a machine with one core, too.
            num_cpus=max(4, os.cpu_count() or 1),
            include_dashboard=False,
            object_store_memory=_OBJECT_STORE_BYTES,
            _temp_dir=str(self._folder),
            **quiet,
        )
        self._guard_processes()

    def rehearse(self) -> None:
        """Try in another process whether `connect` would do. Raises RuntimeError; may be called in any thread."""
        rehearse(self._address, self._folder.with_name("try"), self._lifeline)

    def disconnect(self) -> None:
        """Leave the cluster; one of our own ends, with every process of it."""
        # From now on nothing of it is missed.
        ending, self._guarded = self._guarded, {}
        ray = _import_ray()
        ray.shutdown()
        _forget_controller()
        deadline = time.monotonic() + 5
        for pid in ending:
            while _is_alive(pid) and time.monotonic() < deadline:
                time.sleep(0.02)
            if _is_alive(pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, 9)
            self._lifeline.release(pid)

    def missing_process(self) -> str | None:
        """Return what ended although the cluster is ours and should run, None when all is well.

        May be called in any thread: it reads /proc and asks nothing of Ray, whose calls hang when its processes are gone.
        """
        ended = [f"Ray's {name} (process {pid})" for pid, name in self._guarded.items() if not _is_alive(pid)]
        return f"{ended[0]} has ended" if ended else None

    def remove_logs_of_ended(self) -> None:
        """Remove what ended processes of our own cluster have logged; may be called in any thread."""
        if self.is_ours:
            remove_logs_of_ended(self._folder / "session_latest" / "logs")

    def _guard_processes(self) -> None:
        # Ray's own parent-death signals miss the two agents below the raylet, which stay for ten seconds.
        found: dict[int, str] = {}
        for pid in descendants(os.getpid()):
            if _belongs_to(pid, self._folder):
                self._lifeline.guard(pid)
                found[pid] = "process"
                with contextlib.suppress(OSError):
                    found[pid] = process_name(pid)
        self._guarded = found


def _import_ray() -> Any:
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    import ray

    logging.getLogger("ray").setLevel(logging.ERROR)
    return ray


def _choose_token() -> None:
    """Let nobody else on this machine run code in our workers: Ray's ports are open to all its users.

    A cluster of our own asks for a token by default; without ours, Ray would write one into the home folder, which
    a container's user may not have.
    """
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))


def _stay_on_loopback() -> None:
    """Let Ray listen where it is told to: it takes 127.0.0.1 for this machine's address in the network, and opens its ports to that."""
    from ray._private import services

    if hasattr(services, "resolve_ip_for_localhost"):
        services.resolve_ip_for_localhost = lambda host: host
    else:
        _log.warning("Ray has changed: its ports may be open to the network; close them with a firewall")


def _start_only_what_is_needed() -> None:
    """Leave out autoscaler monitor, API server and log monitor, which serve a dashboard that we do not have.

    `ray.init` has no switch for them, and waits up to a minute for the API server: 177 MB, and half of the processor time of a start.
    """
    from ray._private.node import Node

    for name in ("start_monitor", "start_api_server", "start_log_monitor"):
        if hasattr(Node, name):
            setattr(Node, name, _start_nothing)
        else:
            _log.warning("Ray has changed: a process of it that nobody needs may run", extra={"call": name})


def _start_nothing(node: Any, **_: Any) -> None:
    """Stand in for a method of Ray's `Node`."""


def _forget_controller() -> None:
    """Let handles of the next cluster look for its own Serve controller.

    Serve keeps one client per controller for the life of the process, and takes the controller of a new cluster for
    the old one when both have the same number, as the first actors of two clusters do.
    """
    try:
        from ray.serve._private.router import SharedRouterLongPollClient

        SharedRouterLongPollClient.get_or_create.cache_clear()
    except (ImportError, AttributeError) as error:
        _log.warning("could not clear a cache of Ray Serve", extra={"error": repr(error)})


def _belongs_to(pid: int, folder: Path) -> bool:
    with contextlib.suppress(OSError):
        process = Path(f"/proc/{pid}")
        mentions_folder = os.fsencode(folder) in (process / "cmdline").read_bytes()
        return mentions_folder or b"ray::" in (process / "cmdline").read_bytes()
    return False


def _is_alive(pid: int) -> bool:
    try:
        # A zombie still has an entry; its state is the first word after the name.
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
