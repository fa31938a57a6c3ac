"""What a worker has to know; it travels with the worker, also to another machine."""

from dataclasses import dataclass


@dataclass(frozen=True)
class WorkerSettings:
    """Values that a worker takes from the service's settings.

    redis_url and storage_url: reachable from every machine that runs a worker. workers_per_machine: that share its
    processors. resident_bytes: map indexes kept in memory, least recently used out. index_lifetime_s: of an index in
    Redis after its last use. max_points, max_points_used: of a scan before and after thinning.
    """

    redis_url: str
    storage_url: str
    workers_per_machine: int = 1
    resident_bytes: int = 2 * 2**30
    max_pixels: int = 100_000_000
    max_points: int = 200_000_000
    max_points_used: int = 500_000
    index_lifetime_s: int = 30 * 24 * 3600
