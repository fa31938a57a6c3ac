"""Whether the machines of a Ray cluster that we joined have the same version, and see the same Redis and the same storage, as we do."""

import secrets

import redis

from service.host.service_version import service_version
from service.worker.plan import WorkerSettings

_TOKENS = "cluster/token-"
_TIMEOUT_S = 5.0


def leave_token(settings: WorkerSettings) -> str:
    """Leave a token in storage that other machines should find, and return it."""
    # A file of its own for each: several front doors may ask at the same time.
    token = secrets.token_hex(8)
    settings.open_storage().put(_TOKENS + token, token.encode())
    return token


def take_token_back(settings: WorkerSettings, token: str) -> None:
    """Remove the token once all machines have looked for it."""
    settings.open_storage().delete(_TOKENS + token)


def missing_here(settings: WorkerSettings, token: str, version: str) -> list[str]:
    """Return what this machine cannot reach, or has in another version, one sentence each; empty when all is well."""
    missing = []
    if service_version() != version:
        missing.append(f"expected panoloc {version}, got {service_version()}; install one version on the whole cluster")
    try:
        redis.Redis.from_url(settings.redis_url, socket_timeout=_TIMEOUT_S, socket_connect_timeout=_TIMEOUT_S).ping()
    except (redis.RedisError, OSError) as error:
        address = settings.redis_url.rpartition("@")[2]
        missing.append(
            f"expected an answer from Redis at {address}, got {error}; set PANOLOC_REDIS_URL to one that all machines"
            " of the cluster reach"
        )
    try:
        found = settings.open_storage().read(_TOKENS + token).decode()
    except Exception as error:
        found = str(error)
    if found != token:
        missing.append(
            f"expected the files of {settings.storage_url}, got {found}; set PANOLOC_DATA_DIR to a folder that all"
            " machines of the cluster share, or PANOLOC_STORAGE to a bucket"
        )
    return missing
