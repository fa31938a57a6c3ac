"""Map indexes in Redis: written after registration, read by every worker, lost without harm."""

import redis

from service.pool import MapRef


class IndexShelf:
    """Binary indexes under `index:{map}:{revision}:{digest of the configuration}`."""

    def __init__(self, client: "redis.Redis[bytes]", lifetime_s: int) -> None:
        """lifetime_s: how long an index stays that nobody reads; a full Redis drops the longest unread first."""
        self._client = client
        self._lifetime_s = lifetime_s

    def load(self, map_ref: MapRef, config_digest: str) -> bytes | None:
        """Return an encoded index, None when it is not there. Raises redis.RedisError."""
        found = self._client.getex(index_key(map_ref, config_digest), ex=self._lifetime_s)
        return None if found is None else bytes(found)

    def save(self, map_ref: MapRef, config_digest: str, encoded: bytes) -> None:
        """Store an encoded index. Raises redis.RedisError."""
        self._client.set(index_key(map_ref, config_digest), encoded, ex=self._lifetime_s)


def index_key(map_ref: MapRef, config_digest: str) -> str:
    """Return the key of an index; another configuration of the algorithm has another key."""
    return f"index:{map_ref.id}:{map_ref.revision}:{config_digest}"
