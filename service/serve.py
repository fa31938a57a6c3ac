"""`panoloc serve`: the HTTP process with its embedded Redis and its workers, from start to end."""

import contextlib
import ctypes
import logging
import os
from collections.abc import MutableMapping

from panoloc.service.app import create_app
from panoloc.service.errors import TryAgainError
from panoloc.service.host.embedded_redis import EmbeddedRedis, EmbeddedRedisError
from panoloc.service.host.logging import configure_logging
from panoloc.service.host.process_resources import can_filter_system_calls
from panoloc.service.host.run_folder import DataFolderInUseError, RunFolder, lock_folder
from panoloc.service.host_names import is_loopback
from panoloc.service.http.server import DrainingServer, server_config
from panoloc.service.pool.process_pool import ProcessPool, local_pool
from panoloc.service.settings import Settings
from panoloc.service.storage import Storage, open_storage
from panoloc.service.storage.bucket import BucketStorage
from panoloc.service.storage.claim import BucketClaim, BucketUnusableError
from panoloc.service.storage.urls import variables_of_buckets
from panoloc.service.worker.plan import WorkerPlan

_log = logging.getLogger(__name__)

_WHY_NO_START = (DataFolderInUseError, BucketUnusableError, EmbeddedRedisError, TryAgainError)
# Settings are read by now, and the workers get theirs with the plan.
_SECRETS = ("PANOLOC_API_KEYS", "PANOLOC_API_KEY", "PANOLOC_REDIS_URL")


def run_service(settings: Settings) -> int:
    """Run until SIGTERM or SIGINT and return 0; return 1 when the service could not start.

    When it loses its bucket to another service, it returns 1 as well, so that a supervisor starts another.
    """
    configure_logging(settings.log_level, settings.log_format)
    access = settings.bucket_access  # reads what is taken out of the environment now
    take_secrets_out(os.environ)
    if exposure := why_exposed(settings):
        _log.warning(exposure)
    if settings.keys.file.is_lost:
        _log.warning(
            "the key file is missing, so the service asks for none of its keys; restore it, or make keys with `panoloc keys make`",
            extra={"path": str(settings.keys.file.path.resolve())},
        )
    if not can_filter_system_calls():
        _log.warning(
            "scan readers run without a filter of system calls, because this system has none; memory and time limits "
            "still apply"
        )
    with contextlib.ExitStack() as stack:
        try:
            folder = RunFolder(settings.data_dir, settings.shared)
            stack.callback(folder.close)
            storage = open_storage(settings.storage_url, access)
            claim = _claim(settings, storage, stack)
            redis_url = settings.redis_url or _start_redis(folder, stack)
            _log.info("the data folder is open", extra={"folder": str(settings.data_dir.resolve())})
        except (*_WHY_NO_START, OSError) as error:
            _log.error("the service cannot start", extra={"error": str(error)})
            return 1
        loss = _serve(settings.model_copy(update={"redis_url": redis_url}), storage, claim)
    return 0 if loss is None else 1


def why_exposed(settings: Settings) -> str | None:
    """Return what to warn of when others than this machine reach the service without a key, None when all is well."""
    if settings.keys.required or is_loopback(settings.host):
        return None
    return (
        f"anybody who can reach {settings.host or 'any address of this machine'} port {settings.port} may read, "
        "change and delete every "
        "map: set PANOLOC_API_KEYS, or publish the port of a container for this machine only"
    )


def take_secrets_out(environment: MutableMapping[str, str]) -> None:
    """Remove the keys of callers and of buckets from what child processes inherit or may look up: some of them read files of strangers.

    Linux shows other processes of the same user the environment that a process was started with (`/proc/…/environ`), whatever was unset
    since: of variables of this process, the bytes that they were passed in go too.
    """
    for name in (*_SECRETS, *variables_of_buckets(environment)):
        if environment is os.environ:
            _overwrite(name)
        environment.pop(name, None)


def _overwrite(name: str) -> None:
    with contextlib.suppress(OSError, AttributeError):  # a system without such a library shows nothing either
        libc = ctypes.CDLL(None)
        libc.getenv.restype = ctypes.c_void_p
        address = libc.getenv(os.fsencode(name))
        if address:
            ctypes.memset(address, ord("*"), len(ctypes.string_at(address)))


def build_pool(settings: Settings, redis_url: str) -> ProcessPool:
    """Put the pool together from the settings; nothing starts yet."""
    plan = WorkerPlan.of(settings, redis_url)
    if settings.ray_address is None:
        return local_pool(settings, plan)
    from panoloc.service.ray.bridge_pool import BridgePool

    return BridgePool(settings, plan)


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


def _start_redis(folder: RunFolder, stack: contextlib.ExitStack) -> str:
    server = EmbeddedRedis(folder.path)
    stack.callback(server.stop)
    server.start()
    return server.url


def _serve(settings: Settings, storage: Storage, claim: BucketClaim | None) -> str | None:
    """Run the HTTP process to its end; return what was lost when that made it end."""
    assert settings.redis_url is not None
    pool = build_pool(settings, settings.redis_url)
    app = create_app(settings, pool, storage)
    tls = {"ssl_certfile": settings.tls_cert, "ssl_keyfile": settings.tls_key}
    config = server_config(app, host=settings.host, port=settings.port, **tls)
    server = DrainingServer(config, app.state.services, settings.drain_s)
    if claim is not None:
        claim.when_lost = server.end
    server.run()
    return claim.loss if claim is not None else None
