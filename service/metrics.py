"""Prometheus metrics: units in the names, labels from closed sets.

`Metrics` has a registry of its own, so that several applications can live in one process (tests).
"""

from collections.abc import Callable, Iterator

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.process_collector import ProcessCollector

from panoloc.service.jobs import PoolState

_METHODS = frozenset({"GET", "POST", "PUT", "PATCH", "DELETE", "HEAD", "OPTIONS"})
_STAGES = (
    "queue", "load", "decode", "prepare", "color_matching", "search", "candidates", "refine", "judge", "confidence",
    "change", "pictures", "total",
)  # fmt: skip
_MAP_STATUSES = ("queued", "ready", "failed")
_INDEX_SOURCES = ("resident", "redis", "storage", "missing")
_SECONDS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60, 120, 300)


class Metrics:
    """Counts and times; what the pool and the registry know is read when Prometheus asks."""

    def __init__(self, pool_state: Callable[[], PoolState], maps_by_status: Callable[[], dict[str, int]]) -> None:
        self._registry = CollectorRegistry()
        self._requests = Counter(
            "panoloc_http_requests", "Requests answered.", ("method", "route", "status"), registry=self._registry
        )
        self._request_seconds = Histogram(
            "panoloc_http_request_duration_seconds", "From the first byte of a request to the last of its answer.",
            ("method", "route"), buckets=_SECONDS, registry=self._registry,
        )  # fmt: skip
        self._localizations = Counter(
            "panoloc_localizations", "Queries by their result.", ("method", "result"), registry=self._registry
        )
        self._stage_seconds = Histogram(
            "panoloc_localization_stage_duration_seconds", "Stages of a query.", ("stage",), buckets=_SECONDS,
            registry=self._registry,
        )  # fmt: skip
        self._registrations = Counter(
            "panoloc_registrations", "Registrations by their result.", ("result",), registry=self._registry
        )
        self._registration_seconds = Histogram(
            "panoloc_registration_duration_seconds", "From a worker's first attempt to the ready map.",
            buckets=_SECONDS, registry=self._registry,
        )  # fmt: skip
        self.upload_bytes = Counter("panoloc_upload_bytes", "Bytes of scans stored.", registry=self._registry)
        self._refusals = Counter(
            "panoloc_refusals", "Requests beyond a limit, by limit.", ("limit",), registry=self._registry
        )
        self.uploads = Gauge("panoloc_uploads", "Uploads of scans and batches in progress.", registry=self._registry)
        for result in ("ready", "failed", "cancelled"):
            self._registrations.labels(result)
        self._pool_state, self._maps_by_status = pool_state, maps_by_status
        self._registry.register(self)
        ProcessCollector(registry=self._registry)

    def note_request(self, method: str, route: str, status: int, duration_s: float) -> None:
        """Count a request; route: its template, never the raw path."""
        method = method if method in _METHODS else "other"
        self._requests.labels(method, route, str(status)).inc()
        self._request_seconds.labels(method, route).observe(duration_s)

    def note_localization(self, method: str, result: str, timings_s: dict[str, float]) -> None:
        """Count a query; result: its status, or the slug of the problem that it ended in."""
        self._localizations.labels(method, result).inc()
        for stage, seconds in timings_s.items():
            self._stage_seconds.labels(stage if stage in _STAGES else "other").observe(seconds)

    def note_registration(self, result: str, duration_s: float | None = None) -> None:
        """Count a registration; result: "ready", "failed" or "cancelled" (which has no duration)."""
        self._registrations.labels(result).inc()
        if duration_s is not None:
            self._registration_seconds.observe(duration_s)

    def note_refusal(self, limit: str) -> None:
        """Count what went beyond a limit; limit: one of `panoloc.service.limits.capacity.Refusal`."""
        self._refusals.labels(limit).inc()

    def text(self) -> bytes:
        """Return everything in the Prometheus text format."""
        return generate_latest(self._registry)

    def collect(self) -> Iterator[Metric]:
        """Yield what the pool and the registry say now."""
        state = self._pool_state()
        for name, help_text, value in (
            ("panoloc_pool_ready", "1 if workers take queries.", float(state.ready)),
            ("panoloc_workers", "Workers that are up.", state.num_workers),
            ("panoloc_queue_depth", "Queries waiting for a worker.", state.queue_depth),
            ("panoloc_resident_index_bytes", "Map indexes in the workers' memory.", state.resident_bytes),
        ):
            yield GaugeMetricFamily(name, help_text, value)
        yield CounterMetricFamily(
            "panoloc_worker_retries", "Queries repeated by another worker after a worker was lost.", state.num_retries
        )
        loads = CounterMetricFamily("panoloc_index_loads", "Loaded map indexes, by source.", labels=("source",))
        for source in _INDEX_SOURCES:
            loads.add_metric((source,), state.index_loads.get(source, 0))
        yield loads
        maps = GaugeMetricFamily("panoloc_maps", "Maps by the state of their newest revision.", labels=("status",))
        counted = self._maps_by_status()
        for status in _MAP_STATUSES:
            maps.add_metric((status,), counted.get(status, 0))
        yield maps
