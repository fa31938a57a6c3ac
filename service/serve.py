"""`panoloc serve`: the HTTP process with its embedded Redis and its workers, from start to end."""

import contextlib
import logging
import os
import threading
from collections.abc import MutableMapping

from service.app import create_app
from service.cache import Cache
from service.errors import TryAgainError
from service.host.embedded_redis import EmbeddedRedis, EmbeddedRedisError
from service.host.lifeline import Lifeline
from service.host.logging import configure_logging
from service.host.process_resources import can_filter_system_calls
from service.host.run_folder import DataFolderInUseError, RunFolder, lock_folder
from service.host.secret_variables import remove_variables
from service.host_names import is_loopback
from service.http.server import DrainingServer, server_config
from service.ray.cluster import RayCluster
from service.ray.front_doors import FrontDoors
from service.ray.pool import RayPool
from service.ray.queue.admission import Admission
from service.ray.serving import RayServing
from service.settings import Settings
from service.storage import Storage, open_storage
from service.storage.bucket import BucketStorage
from service.storage.claim import BucketClaim, BucketInUseError
from service.storage.opening import variables_of_buckets
from service.storage.start_check import StorageUnusableError, check_at_start
from service.worker.plan import WorkerPlan, WorkerSettings

_log = logging.getLogger(__name__)

# A thread that hangs inside Ray would keep the process; everything that could be lost is stored by then.
_LEAVE_S = 10.0
_WHY_NO_START = (DataFolderInUseError, BucketInUseError, EmbeddedRedisError, StorageUnusableError, TryAgainError)
# Settings are read by now, and the workers get theirs with the plan.
_SECRETS = ("PANOLOC_API_KEYS", "PANOLOC_API_KEY", "PANOLOC_REDIS_URL")


def run_service(settings: Settings) -> int:
    """Run until SIGTERM or SIGINT and return 0; return 1 when the service could not start.

    When it loses the workers of its own cluster, or its bucket to another service, this process ends with exit code 1, so that a
    supervisor starts another.
    """
    configure_logging(settings.log_level, settings.log_format)
    access = settings.bucket_access  # reads what is taken out of the environment now
    take_secrets_out(os.environ)
    if exposure := why_exposed(settings):
        _log.warning(exposure)
    if not can_filter_system_calls():
        _log.warning(
            "readers of scans run without a filter of system calls: this system has none; limits of memory and time hold"
        )
    with contextlib.ExitStack() as stack:
        try:
            folder = RunFolder(settings.data_dir, settings.shared)
            stack.callback(folder.close)
            storage = open_storage(settings.storage_url, access)
            check_at_start(storage, is_shared=settings.shared)
            claim = _claim(settings, storage, stack)
            lifeline = Lifeline()
            stack.callback(lifeline.close)
            redis_url = settings.redis_url or _start_redis(folder, lifeline, stack)
            _log.info("the data folder is open", extra={"folder": str(settings.data_dir.resolve())})
        except (*_WHY_NO_START, OSError) as error:
            _log.error("the service cannot start", extra={"error": str(error)})
            return 1
        loss = _serve(settings.model_copy(update={"redis_url": redis_url}), storage, claim, folder, lifeline)
    if loss is not None:
        # Threads that wait for Ray would be joined otherwise, and what it does at the exit would wait as well.
        logging.shutdown()
        os._exit(1)
    _leave_even_if_a_thread_hangs()
    return 0


def why_exposed(settings: Settings) -> str | None:
    """Return what to warn of when others than this machine reach the service without a key, None when all is well."""
    if settings.keys.required or is_loopback(settings.host):
        return None
    return (
        f"anybody who reaches {settings.host or 'any address of this machine'} port {settings.port} may read, change and delete every "
        "map: set PANOLOC_API_KEYS, or publish the port of a container for this machine only"
    )


def take_secrets_out(environment: MutableMapping[str, str]) -> None:
    """Remove the keys of callers and of buckets from what child processes inherit or may look up: some of them read files of strangers."""
    remove_variables(environment, [*_SECRETS, *variables_of_buckets(environment)])


def build_pool(settings: Settings, redis_url: str, folder: RunFolder, lifeline: Lifeline) -> RayPool:
    """Put the pool together from the settings; nothing starts yet."""
    plan = WorkerPlan(WorkerSettings.of(settings, redis_url))
    front_doors = None if settings.ray_address is None else FrontDoors(plan, settings.num_workers)
    introduction = None if front_doors is None else front_doors.introduction
    cluster = RayCluster(settings.ray_address, folder.path / "ray", lifeline, introduction)
    serving = RayServing(cluster, plan, settings.num_workers, front_doors)
    return RayPool(cluster, serving, Admission(settings.queue_limit), settings.num_registrations)


def _claim(settings: Settings, storage: Storage, stack: contextlib.ExitStack) -> BucketClaim | None:
    """Keep out who must not use the storage beside this service; the data folder does that for itself."""
    if isinstance(storage, BucketStorage):
        claim = BucketClaim(storage, settings.data_dir, is_shared=settings.shared)
        claim.take()
        stack.callback(claim.release)
        return claim
    if settings.storage_folder != settings.data_dir.resolve():
        stack.callback(lock_folder(settings.storage_folder, settings.shared).close)
    return None


def _start_redis(folder: RunFolder, lifeline: Lifeline, stack: contextlib.ExitStack) -> str:
    server = EmbeddedRedis(folder.path, lifeline)
    stack.callback(server.stop)
    server.start()
    return server.url


def _serve(
    settings: Settings, storage: Storage, claim: BucketClaim | None, folder: RunFolder, lifeline: Lifeline
) -> str | None:
    """Run the HTTP process to its end; return what was lost when that made it end."""
    assert settings.redis_url is not None
    pool = build_pool(settings, settings.redis_url, folder, lifeline)
    cache = Cache(settings.redis_url, result_lifetime_s=settings.result_ttl_s)
    app = create_app(settings, pool, cache, storage)
    server = DrainingServer(server_config(app, host=settings.host, port=settings.port), pool, settings.drain_s)
    pool.call_on_loss(server.end)
    if claim is not None:
        claim.call_when_lost(server.end)
    server.run()
    return pool.loss or (claim.loss if claim is not None else None)


def _leave_even_if_a_thread_hangs() -> None:
    timer = threading.Timer(_LEAVE_S, os._exit, args=(0,))
    timer.daemon = True
    timer.start()
