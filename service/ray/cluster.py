"""Ray itself: a small local cluster of our own, or somebody's that we join.

Everything here blocks and has to run in one thread that lives as long as the cluster: Ray's calls are not made for several.
"""

import contextlib
import logging
import os
import secrets
import signal
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.host.lifeline import Lifeline
from service.host.process_resources import SPINNING
from service.host.process_tree import descendants, process_name
from service.ray.contact import Contact
from service.ray.ended_logs import remove_logs_of_ended
from service.ray.own_node import OwnNode, stay_on_loopback
from service.ray.patience import Patience
from service.ray.rehearsal import rehearse

_log = logging.getLogger(__name__)

_NAMESPACE = "panoloc"

# Read by Ray's processes when they start. `setdefault`: an operator's own value wins.
_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # A call that comes after the end would start a cluster of its own.
    "RAY_ENABLE_AUTO_CONNECT": "0",
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
    **SPINNING,
}


class RayCluster:
    """A connection to Ray: `connect`, use, `disconnect`, all in the same thread. patience: how its answers are waited for."""

    def __init__(
        self, address: str | None, folder: Path, lifeline: Lifeline, introduction: Mapping[str, str] | None = None
    ) -> None:
        """address: None for a cluster of our own; folder: short path for its sockets and logs.

        introduction: what a cluster of others shows of us in its list of jobs.
        """
        self._address = address
        self._introduction = dict(introduction or {})
        self._contact: Contact | None = None
        self._ending = threading.Lock()
        self.patience = Patience()
        self._folder = folder
        self._lifeline = lifeline
        self._guarded: dict[int, str] = {}
        self._node: OwnNode | None = None

    @property
    def is_ours(self) -> bool:
        """Tell whether the cluster ends with the service."""
        return self._address is None

    def connect(self) -> None:
        """Start or join; 3 to 10 s. Raises whatever Ray raises (ConnectionError, RuntimeError, ValueError)."""
        self.patience.begin()
        make_record = logging.getLogRecordFactory()
        _set_environment()
        if self._address is None:
            _choose_token()
            # While it starts, this process imports Ray as well.
            self._node = OwnNode(self._folder)
        ray = _import_ray()
        try:
            ray.init(
                address=self._address or self._own_address(),
                _node_ip_address=None if self._address else "127.0.0.1",
                namespace=_NAMESPACE,
                log_to_driver=False,
                logging_level=logging.ERROR,
                configure_logging=False,
                ignore_reinit_error=True,
                job_config=None if self.is_ours else ray.job_config.JobConfig(metadata=self._introduction),
            )
            if self.is_ours:
                self._guard_processes()
            else:
                self._contact = Contact.of_connection(ray)
        finally:
            # Ray adds a field of its own to every log record of the process.
            logging.setLogRecordFactory(make_record)

    def _own_address(self) -> str:
        stay_on_loopback()
        assert self._node is not None
        return self._node.address()

    def rehearse(self) -> None:
        """Try in another process whether joining would do. Raises RayStartError; may be called in any thread.

        A cluster of our own is always started in another process.
        """
        if self._address is not None:
            rehearse(self._address, self._lifeline)

    def disconnect(self) -> None:
        """Leave the cluster; one of our own ends, with every process of it.

        One that we joined may be left in any thread: calls that hang in another one, because it does not answer, end with SystemExit.
        """
        with self._ending:
            self._disconnect()

    def _disconnect(self) -> None:
        self._contact = None
        # From now on nothing of it is missed.
        ending, self._guarded = self._guarded, {}
        ray = _import_ray()
        ray.shutdown()
        _forget_controller()
        for pid in (pid for pid, name in ending.items() if name == "raylet"):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGTERM)  # it ends its workers first
        deadline = time.monotonic() + 5
        # The raylet says goodbye to the GCS, and would wait for one that is gone.
        for pid, name in sorted(ending.items(), key=lambda each: each[1] == "gcs_server"):
            while name != "gcs_server" and _is_alive(pid) and time.monotonic() < deadline:
                time.sleep(0.02)
            if _is_alive(pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self._lifeline.release(pid)
        if self._node is not None:
            self._node.end()
            self._node = None

    def missing_process(self) -> str | None:
        """Return what ended although the cluster is ours and should run, None when all is well.

        May be called in any thread: it reads /proc and asks nothing of Ray, whose calls hang when its processes are gone.
        """
        ended = [f"Ray's {name} (process {pid})" for pid, name in self._guarded.items() if not _is_alive(pid)]
        return f"{ended[0]} has ended" if ended else None

    def silent(self) -> str | None:
        """Return what does not answer of a cluster that we joined, None when all is well; may be called in any thread."""
        contact = self._contact
        return contact.silent() if contact is not None else None

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


def _set_environment() -> None:
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)


def _import_ray() -> Any:
    _set_environment()
    import ray

    logging.getLogger("ray").setLevel(logging.ERROR)
    return ray


def _choose_token() -> None:
    """Let nobody else on this machine run code in our workers: Ray's ports are open to all its users.

    A cluster of our own asks for a token by default; without ours, Ray would write one into the home folder, which
    a container's user may not have.
    """
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))


def _forget_controller() -> None:
    """Let handles of the next cluster look for its own Serve controller.

    Serve keeps one client per controller for the life of the process, and takes the controller of a new cluster for
    the old one when both have the same number, as the first actors, and the first jobs, of two clusters do.
    """
    if "ray.serve" not in sys.modules:
        return
    try:
        from ray.serve._private.router import SharedRouterLongPollClient
        from ray.serve.context import _set_global_client

        SharedRouterLongPollClient.get_or_create.cache_clear()
        _set_global_client(None)
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
