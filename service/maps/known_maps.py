"""What this process knows of maps: their records in memory, as they are stored."""

import asyncio
import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

import structlog

from service.errors import MapNotFoundError, StorageError, StoredFileMissingError
from service.jobs import MapRef
from service.maps.cursors import decode_cursor, encode_cursor
from service.maps.record import MapRecord, coordinate_system_of, read_stamped_record
from service.maps.visible import VisibleMaps
from service.storage import Stamp, Storage

_log = structlog.get_logger(__name__)

_ID = re.compile(r"map_[0-9a-f]{16}")


class KnownMaps:
    """The reading side of a registry. is_shared: other processes change what is stored as well."""

    def __init__(self, storage: Storage, is_shared: bool) -> None:
        self._storage = storage
        self._is_shared = is_shared
        self._records: dict[str, MapRecord] = {}
        # Of the records as they were read or written last.
        self._stamps: dict[str, Stamp] = {}

    def get(self, map_id: str) -> MapRecord:
        """Return a map. Raises MapNotFoundError."""
        record = self._records.get(map_id)
        if record is None:
            raise MapNotFoundError(
                f"expected the id of a map, got {map_id[:80]!r}, which is unknown or deleted; GET /maps lists the maps"
            )
        return record

    def has(self, map_id: str) -> bool:
        """Tell whether there is a map under this id."""
        return map_id in self._records

    def is_current(self, map_id: str, stamp: Stamp) -> bool:
        """Tell whether a map is known as it is stored."""
        return map_id in self._records and self._stamps.get(map_id) == stamp

    def georeferences(self, refs: Iterable[MapRef]) -> dict[str, dict[str, Any]]:
        """Return the georeferences of those of the maps that (still) have one, by map id.

        Of a map that has none but lies in a coordinate system: `{"coordinate_system": …, "geoid_undulation_m": …}`.
        """
        found: dict[str, dict[str, Any]] = {}
        for record in (self._records[ref.id] for ref in refs if ref.id in self._records):
            system = coordinate_system_of(record)
            if record.georeference is not None:
                found[record.id] = record.georeference
            elif system is not None:
                found[record.id] = {"coordinate_system": system, "geoid_undulation_m": record.geoid_undulation_m}
        return found

    def all(self) -> list[MapRecord]:
        """Return all maps, oldest first."""
        return sorted(self._records.values(), key=_order)

    def with_tag(self, tag: str) -> list[MapRecord]:
        """Return the maps that bear a tag, oldest first."""
        return [record for record in self.all() if tag in record.tags]

    def seen_by(self, tenant: str | None) -> VisibleMaps:
        """Return the maps that a tenant sees; None: all."""
        return VisibleMaps(self, tenant)

    def page(
        self, tag: str | None, limit: int, cursor: str | None, tenant: str | None = None
    ) -> tuple[list[MapRecord], str | None]:
        """Return at most `limit` maps after a cursor, and the cursor of the next page.

        Maps that come or go between two pages disturb neither: the cursor names a place in the order, not a number.
        """
        seen = self.seen_by(tenant)
        after = decode_cursor(cursor) if cursor is not None else ("", "")
        found = [each for each in (seen.all() if tag is None else seen.with_tag(tag)) if _order(each) > after]
        more = len(found) > limit
        return found[:limit], encode_cursor(*_order(found[limit - 1])) if more else None

    def num_by_status(self, tenant: str | None = None) -> Counter[str]:
        """Count the maps that a tenant sees, None for all, by what became of their newest revision."""
        return Counter(record.newest.status for record in self._records.values() if record.is_seen_by(tenant))

    def failed(self) -> list[MapRecord]:
        """Return the maps whose newest revision could not be built, oldest first."""
        return [record for record in self.all() if record.newest.status == "failed"]

    def holds(self, ref: MapRef) -> bool:
        """Tell whether the record of a map names this revision, so that its files are kept."""
        record = self._records.get(ref.id)
        return record is not None and record.revision(ref.revision) is not None

    async def _look(self, map_id: str) -> None:
        """Take over what is stored of a map; in its turn, so that nothing of our own is half done meanwhile."""
        try:
            found, stamp = await asyncio.to_thread(read_stamped_record, self._storage, map_id)
            self._records[map_id], self._stamps[map_id] = found, stamp
        except StoredFileMissingError:
            self._records.pop(map_id, None)
            self._stamps.pop(map_id, None)
        except StorageError as error:
            _log.error("a map stays as it was, its record cannot be read", map_id=map_id, error=str(error))


def is_id(map_id: str) -> bool:
    """Tell whether a map could have this id."""
    return _ID.fullmatch(map_id) is not None


def _order(record: MapRecord) -> tuple[str, str]:
    return record.created_at, record.id
