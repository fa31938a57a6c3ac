"""One map: what is known of it, as it is stored and as it is shown.

Written by the HTTP process alone, read by workers that rebuild an index. A record lies in storage under
`maps/{id}/map.json` and contains its own digest, because it is replaced in one step.
"""

from dataclasses import field
from typing import Any, Literal

from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass

from panoloc.service.jobs import ON_EARTH, MapRef, RegisterOptions
from panoloc.service.storage import Stamp, Storage
from panoloc.service.storage.sealed_json import seal, unseal

RevisionStatus = Literal["queued", "ready", "failed"]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Revision:
    """One uploaded scan of a map and its registration.

    number: from 1. scan_key: in storage. scan_sha256: hexadecimal. options: as in `RegisterJob`.
    unpacked_bytes: those that an archive announces, None for other files.
    num_attempts: registrations of it that began, also before the service was started again.
    stats, diagnostics: as in the HTTP contract, once ready. error: a problem document, once failed.
    """

    number: int
    scan_key: str
    scan_name: str
    scan_bytes: int
    scan_sha256: str
    options: RegisterOptions
    unpacked_bytes: int | None = None
    status: RevisionStatus = "queued"
    num_attempts: int = 0
    stats: dict[str, Any] | None = None
    diagnostics: list[dict[str, Any]] = field(default_factory=list)
    error: dict[str, Any] | None = None


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class MapRecord:
    """One map. Times are RFC 3339 in UTC.

    newest: the revision uploaded last. serving: the one that answers queries: `newest` itself once that is ready, an
    older one until then, None before the first is ready.
    owner: the tenant of the key that made it; None: seen by keys without a tenant alone. shared_with: further tenants,
    "*" for all. coordinate_system: EPSG code or WKT, where it was given. geoid_undulation_m: height of the geoid above
    the ellipsoid, likewise. version: how often the record was written.
    """

    id: str
    name: str
    created_at: str
    updated_at: str
    newest: Revision
    serving: Revision | None = None
    tags: list[str] = field(default_factory=list)
    georeference: dict[str, Any] | None = None
    coordinate_system: str | None = None
    geoid_undulation_m: float | None = None
    owner: str | None = None
    shared_with: list[str] = field(default_factory=list)
    version: int = 0

    @property
    def newest_ref(self) -> MapRef:
        """Return the reference of the newest revision."""
        return MapRef(self.id, self.newest.number)

    @property
    def serving_ref(self) -> MapRef | None:
        """Return the reference of the revision that answers queries."""
        return None if self.serving is None else MapRef(self.id, self.serving.number)

    def belongs_to(self, tenant: str | None) -> bool:
        """Tell whether a caller may change it. tenant: None for one that sees all."""
        return tenant is None or self.owner == tenant

    @property
    def visitors(self) -> str:
        """Return the tenant of the keys in links to this map, which need not be shared with it."""
        return f"visitors-{self.id}"

    def is_seen_by(self, tenant: str | None) -> bool:
        """Tell whether a caller may know of it."""
        return self.belongs_to(tenant) or not {tenant, "*"}.isdisjoint([self.visitors, *self.shared_with])

    def revision(self, number: int) -> Revision | None:
        """Return a revision by its number, None when its scan is not kept."""
        return next((each for each in (self.newest, self.serving) if each and each.number == number), None)


_MAP_RECORD = TypeAdapter(MapRecord)


def map_document(record: MapRecord, progress: dict[str, Any] | None) -> dict[str, Any]:
    """Return the JSON of a map; progress: last report of its registration, None when it has not begun."""
    newest, serving = record.newest, record.serving
    shown = newest if newest.status == "ready" or serving is None else serving
    if newest.status != "queued":
        progress = {"status": newest.status, "stage": None, "progress": 1.0 if newest.status == "ready" else 0.0}
    elif progress is None:
        progress = {"status": "queued", "stage": "waiting for other registrations, or for workers", "progress": 0.0}
    return {
        "id": record.id,
        "name": record.name,
        "tags": record.tags,
        "revision": newest.number,
        "serving_revision": None if serving is None else serving.number,
        **{name: progress[name] for name in ("status", "stage", "progress")},
        "error": newest.error,
        "created_at": record.created_at,
        "updated_at": record.updated_at,
        "stats": shown.stats,
        "diagnostics": shown.diagnostics,
        **place_on_earth(record),
        "owner": record.owner,
        "shared_with": record.shared_with,
        "version": record.version,
    }


def place_on_earth(record: MapRecord) -> dict[str, Any]:
    """Return the values of `ON_EARTH`."""
    values = record.georeference, coordinate_system_of(record), record.geoid_undulation_m
    return dict(zip(ON_EARTH, values, strict=True))


def bounds_of(record: MapRecord) -> dict[str, list[float]] | None:
    """Return `min` and `max` of the serving scan."""
    stats = None if record.serving is None else record.serving.stats
    return (stats or {}).get("bounds")


def coordinate_system_of(record: MapRecord) -> str | None:
    """Return the coordinate system of a map's positions: the one that was given, else that of the serving scan."""
    stats = None if record.serving is None else record.serving.stats
    return record.coordinate_system or (stats or {}).get("coordinate_system")


def folder_of(map_id: str) -> str:
    """Return the prefix below which everything of a map is stored."""
    return f"maps/{map_id}"


def key_of(ref: MapRef, name: str) -> str:
    """Return the key of a file of one revision: `scan.ply`, `preview.png`, `points.ply`, `starts.json`."""
    return f"maps/{ref.id}/{ref.revision}/{name}"


def read_record(storage: Storage, map_id: str) -> MapRecord:
    """Return the record of a map. Raises StoredFileMissingError and StoredFileDamagedError."""
    return read_stamped_record(storage, map_id)[0]


def read_stamped_record(storage: Storage, map_id: str) -> tuple[MapRecord, Stamp]:
    """Return the record of a map with its stamp, for `write_record`. Raises as `read_record` does."""
    data, stamp = storage.read_stamped(_record_key(map_id))
    return unseal(_MAP_RECORD, data, _record_key(map_id)), stamp


def write_record(storage: Storage, record: MapRecord, over: Stamp | None = None) -> Stamp:
    """Store a record over its predecessor and return its stamp.

    over: stamp of the predecessor; None: any. Raises StoredFileChangedError.
    """
    return storage.replace(_record_key(record.id), seal(_MAP_RECORD, record), over)


def _record_key(map_id: str) -> str:
    return f"{folder_of(map_id)}/map.json"
