"""One map: what is known of it, as it is stored and as it is shown.

Written by the HTTP process alone, read by workers that rebuild an index.

A record lives in storage under `maps/{id}/map.json` and bears its own digest, because it is replaced in one step.
"""

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field
from typing import Any, Literal, Self, cast

from core.errors import OptionsError
from core.options import Box, IndexOptions, ScanOptions
from service.errors import StoredFileDamagedError
from service.jobs import MapRef, RegisterOptions
from service.storage import Stamp, Storage

RevisionStatus = Literal["queued", "ready", "failed"]

ON_EARTH = ("georeference", "coordinate_system", "geoid_undulation_m")
"""What the document of a map says of its place on Earth."""

_FORMAT = 1


@dataclass(frozen=True)
class Revision:
    """One uploaded scan of a map and what became of it.

    number: from 1. scan_key: in storage. scan_sha256: hexadecimal. options: as in `RegisterJob`.
    num_attempts: registrations of it that began, also before the service was started again.
    stats, diagnostics: as in the HTTP contract, once ready. error: a problem document, once failed.
    """

    number: int
    scan_key: str
    scan_name: str
    scan_bytes: int
    scan_sha256: str
    options: RegisterOptions
    status: RevisionStatus = "queued"
    num_attempts: int = 0
    stats: dict[str, Any] | None = None
    diagnostics: list[dict[str, Any]] = field(default_factory=list)
    error: dict[str, Any] | None = None


@dataclass(frozen=True)
class MapRecord:
    """One map. Times are RFC 3339 in UTC.

    newest: the revision uploaded last. serving: the one that answers queries: `newest` itself once that is ready, an
    older one until then, None before the first is ready.
    owner: the tenant of the key that made it, None: seen by keys without a tenant alone. shared_with: further tenants, "*" for all.
    coordinate_system: by EPSG code or WKT, where somebody said so. geoid_undulation_m: of the geoid above the ellipsoid, likewise.
    version: how often the record was written.
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

    def is_seen_by(self, tenant: str | None) -> bool:
        """Tell whether a caller may know of it."""
        return self.belongs_to(tenant) or not {tenant, "*"}.isdisjoint(self.shared_with)

    def revision(self, number: int) -> Revision | None:
        """Return a revision by its number, None when its scan is not kept."""
        return next((each for each in (self.newest, self.serving) if each and each.number == number), None)

    def to_json(self) -> bytes:
        """Return the record as stored."""
        record = dataclasses.asdict(self)
        # Beside the record: an older service reads it.
        version = record.pop("version")
        for name in ("coordinate_system", "geoid_undulation_m", "owner", "shared_with"):
            if record[name] in (None, []):
                del record[name]  # versions of before it read what does not need it
        for name in ("newest", "serving"):
            revision: Revision | None = getattr(self, name)
            if revision is not None:
                record[name]["options"] = options_to_json(revision.options)
                if not revision.num_attempts:
                    # As it was before attempts were counted: an older service reads it.
                    del record[name]["num_attempts"]
        document = {"format": _FORMAT, "version": version, "sha256": _digest(record), "record": record}
        return json.dumps(document, indent=1).encode()

    @classmethod
    def from_json(cls, data: bytes, key: str) -> Self:
        """Read what `to_json` wrote; key: for the message of StoredFileDamagedError."""
        try:
            document = json.loads(data)
            record = document["record"]
            if document["sha256"] != _digest(record):
                raise ValueError("its digest differs")
            newest, serving = _revision(record.pop("newest")), record.pop("serving")
            version = int(document.get("version", 0))
            return cls(
                newest=newest, serving=None if serving is None else _revision(serving), version=version, **record
            )
        except (ValueError, KeyError, TypeError, AttributeError, OptionsError) as error:
            raise StoredFileDamagedError(
                f"{key}: expected a map record as the service wrote it, but {error}; restore the file from a backup"
            ) from error


def map_document(record: MapRecord, progress: dict[str, Any] | None) -> dict[str, Any]:
    """Return the JSON of a map; progress: what its registration reported last, None when it has not begun."""
    newest, serving = record.newest, record.serving
    shown = newest if newest.status == "ready" or serving is None else serving
    return {
        "id": record.id,
        "name": record.name,
        "tags": record.tags,
        "revision": newest.number,
        "serving_revision": None if serving is None else serving.number,
        **_state(newest.status, progress),
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
    return dict(
        zip(ON_EARTH, (record.georeference, coordinate_system_of(record), record.geoid_undulation_m), strict=True)
    )


def coordinate_system_of(record: MapRecord) -> str | None:
    """Return the coordinate system of a map's positions: what was said of it, else what the scan that answers queries says."""
    stats = None if record.serving is None else record.serving.stats
    return record.coordinate_system or (stats or {}).get("coordinate_system")


def _state(status: str, progress: dict[str, Any] | None) -> dict[str, Any]:
    if status != "queued":
        return {"status": status, "stage": None, "progress": 1.0 if status == "ready" else 0.0}
    if progress is None:
        return {"status": "queued", "stage": "waiting for other registrations, or for workers", "progress": 0.0}
    return {"status": progress["status"], "stage": progress["stage"], "progress": progress["progress"]}


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
    key = _record_key(map_id)
    data, stamp = storage.read_stamped(key)
    return MapRecord.from_json(data, key), stamp


def write_record(storage: Storage, record: MapRecord, over: Stamp | None = None) -> Stamp:
    """Store a record over its predecessor and return its stamp. over: of the predecessor; None: whatever it is. Raises
    StoredFileChangedError."""
    return storage.replace(_record_key(record.id), record.to_json(), over)


def options_to_json(options: RegisterOptions) -> dict[str, Any]:
    """Return options in the form of the HTTP contract, in which they are stored."""
    scan, index = options.scan, options.index
    region = None if index.region is None else {"min": list(index.region[0]), "max": list(index.region[1])}
    return {
        "unit": scan.unit,
        "up_axis": scan.up_axis,
        "color_kind": scan.color_kind,
        "starts": {"method": index.starts_method, "spacing_m": index.spacing_m, "region": region},
    }


def options_from_json(stored: dict[str, Any]) -> RegisterOptions:
    """Return what `options_to_json` was given; fields that are missing have their defaults. Raises OptionsError."""
    of_both = {name: stored[name] for name in ("color_kind",) if name in stored}
    of_scan = {name: stored[name] for name in ("unit", "up_axis") if name in stored}
    starts = dict(stored.get("starts") or {})
    region = starts.pop("region", None)
    if "method" in starts:
        starts["starts_method"] = starts.pop("method")
    box = None if region is None else cast(Box, (tuple(region["min"]), tuple(region["max"])))
    return RegisterOptions(ScanOptions(**of_scan, **of_both), IndexOptions(**starts, **of_both, region=box))


def _revision(stored: dict[str, Any]) -> Revision:
    return Revision(**{**stored, "options": options_from_json(stored["options"])})


def _record_key(map_id: str) -> str:
    return f"maps/{map_id}/map.json"


def _digest(record: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()
