"""How long it takes to load a map index from Redis, as a worker does that holds it no more."""

import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import torch

from core.index.map_codec import decode_map_index, encode_map_index
from core.index.map_index import MapIndex
from lab.benchmark.service.measured_service import SHORT_PREFIX
from lab.benchmark.sizes import Sizes
from lab.benchmark.timing import Spread, repeated
from service.cache import WorkerCache
from service.host.embedded_redis import EmbeddedRedis, EmbeddedRedisError
from service.host.lifeline import Lifeline
from service.host.run_folder import RunFolder
from service.jobs import MapRef

_REF, _DIGEST = MapRef("map_bench", 1), "0" * 16
_LIFETIME_S = 3600


class NoRedisError(Exception):
    """No Redis of our own could be started here."""


@dataclass(frozen=True)
class RedisFigures:
    """store: into Redis. load: out of Redis and decoded, up to the arrays on the device."""

    store: Spread
    load: Spread


def time_redis(index: MapIndex, sizes: Sizes, device: torch.device) -> RedisFigures:
    """Store and load an index in a Redis that is started for it. Raises NoRedisError where that is not possible."""
    with ExitStack() as stack:
        cache = _started_redis(stack)
        encoded = encode_map_index(index)
        times = sizes.repeats, device, sizes.warm_ups
        store = repeated(lambda: cache.put_index(_REF, _DIGEST, encoded), *times)
        return RedisFigures(store, repeated(lambda: decode_map_index(_stored(cache), device), *times))


def _stored(cache: WorkerCache) -> bytes:
    found = cache.get_index(_REF, _DIGEST)
    if found is None:
        raise NoRedisError(
            "index: expected what was stored in Redis a moment ago, got nothing; is its memory too small?"
        )
    return found


def _started_redis(stack: ExitStack) -> WorkerCache:
    try:
        folder = RunFolder(Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=SHORT_PREFIX))))
        stack.callback(folder.close)
        lifeline = Lifeline()
        stack.callback(lifeline.close)
        server = EmbeddedRedis(folder.path, lifeline)
        stack.callback(server.stop)
        server.start()
    except (EmbeddedRedisError, ImportError, OSError) as error:
        raise NoRedisError(f"index: expected to start a Redis for the loading, got: {error}") from error
    cache = WorkerCache(server.url, index_lifetime_s=_LIFETIME_S)
    stack.callback(cache.close)
    return cache
