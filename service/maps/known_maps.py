"""Maps that are known to this process: their records in memory, as they are stored."""

import base64
import json
from collections import Counter
from collections.abc import Iterable
from typing import Any

from panoloc.service.errors import InvalidOptionsError, MapNotFoundError
from panoloc.service.jobs import MapRef
from panoloc.service.maps.record import MapRecord, coordinate_system_of


class VisibleMaps:
    """The maps that one caller sees: the reading side of a registry. tenant: None sees all maps."""

    def __init__(self, records: dict[str, MapRecord], tenant: str | None) -> None:
        self._records = records
        self.tenant = tenant

    def get(self, map_id: str) -> MapRecord:
        """Return a map. Raises MapNotFoundError, in the same words for one of other tenants."""
        record = self._records.get(map_id)
        if record is None or not record.is_seen_by(self.tenant):
            others = (
                "" if self.tenant is None else ", or of a tenant that does not share it with this key (shared_with)"
            )
            named = ", ".join(each.id for each in self.all() if each.name == map_id)
            known = f"the name of {named}; send the id" if named else f"unknown or deleted{others}"
            raise MapNotFoundError(
                f"expected the id of a map, got {map_id[:80]!r}, which is {known}; see the list of maps (GET /maps, panoloc maps)"
            )
        return record

    def has(self, map_id: str) -> bool:
        """Tell whether there is a map under this id."""
        record = self._records.get(map_id)
        return record is not None and record.is_seen_by(self.tenant)

    def all(self) -> list[MapRecord]:
        """Return all maps, oldest first."""
        return sorted((each for each in self._records.values() if each.is_seen_by(self.tenant)), key=_order)

    def with_tag(self, tag: str) -> list[MapRecord]:
        """Return the maps with a tag, oldest first."""
        return [record for record in self.all() if tag in record.tags]

    def seen_by(self, tenant: str | None) -> "VisibleMaps":
        """Return the maps that a tenant sees; None: all."""
        return VisibleMaps(self._records, tenant)

    def georeferences(self, refs: Iterable[MapRef]) -> dict[str, dict[str, Any]]:
        """Return the georeferences of those of the maps that (still) have one, by map id.

        Of a map without one in a coordinate system: `{"coordinate_system": …, "geoid_undulation_m": …}`.
        """
        found: dict[str, dict[str, Any]] = {}
        for record in (self._records[ref.id] for ref in refs if ref.id in self._records):
            system = coordinate_system_of(record)
            if record.georeference is not None:
                found[record.id] = record.georeference
            elif system is not None:
                found[record.id] = {"coordinate_system": system, "geoid_undulation_m": record.geoid_undulation_m}
        return found

    def page(self, tag: str | None, limit: int, cursor: str | None) -> tuple[list[MapRecord], str | None]:
        """Return at most `limit` maps after a cursor, and the cursor of the next page.

        Maps that come or go between two pages do not disturb: a cursor is a place in the order, not a number.
        """
        after = decode_cursor(cursor) if cursor is not None else ("", "")
        found = [each for each in (self.all() if tag is None else self.with_tag(tag)) if _order(each) > after]
        more = len(found) > limit
        return found[:limit], encode_cursor(*_order(found[limit - 1])) if more else None

    def num_by_status(self) -> Counter[str]:
        """Count the maps by the status of their newest revision."""
        return Counter(record.newest.status for record in self.all())

    def failed(self) -> list[MapRecord]:
        """Return the maps whose newest revision could not be built, oldest first."""
        return [record for record in self.all() if record.newest.status == "failed"]

    def holds(self, ref: MapRef) -> bool:
        """Tell whether the record of a map names this revision, so that its files are kept."""
        record = self._records.get(ref.id)
        return record is not None and record.revision(ref.revision) is not None


def _order(record: MapRecord) -> tuple[str, str]:
    return record.created_at, record.id


def encode_cursor(created_at: str, map_id: str) -> str:
    """Return a place in the order of a list as text that survives a URL; maps may come and go between two pages."""
    return base64.urlsafe_b64encode(json.dumps([created_at, map_id]).encode()).decode().rstrip("=")


def decode_cursor(cursor: str) -> tuple[str, str]:
    """Return what `encode_cursor` was given. Raises InvalidOptionsError."""
    try:
        padded = cursor.encode("ascii") + b"=" * (-len(cursor) % 4)
        created_at, map_id = json.loads(base64.b64decode(padded, altchars=b"-_", validate=True))
        if isinstance(created_at, str) and isinstance(map_id, str):
            return created_at, map_id
    except (ValueError, TypeError, RecursionError):
        pass
    message = f"expected the next_cursor of an earlier page, got {cursor[:80]!r}; begin again without a cursor"
    raise InvalidOptionsError.of("cursor", message)
