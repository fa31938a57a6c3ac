"""All maps of the service: in memory for reading, in storage for good.

The only writer of what is stored of maps. What is done to one map is done in turn, so that no file is written while its
folder is being deleted; different maps do not wait for each other.
"""

import asyncio
import base64
import binascii
import json
from collections import Counter
from collections.abc import Callable, Coroutine, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import structlog

from service.errors import InvalidOptionsError, MapLimitError, MapNotFoundError, StorageError
from service.jobs import MapRef, now
from service.maps.record import MapRecord, Revision, coordinate_system_of, folder_of, key_of, read_record, write_record
from service.maps.scan_size import counted_bytes
from service.maps.visible import VisibleMaps
from service.storage import Storage

Result = TypeVar("Result")

_log = structlog.get_logger(__name__)


class MapRegistry:
    """Used from one event loop.

    A change is in storage before it is seen in memory; a deletion is seen first, so that nobody finds a map whose files
    are going.
    """

    def __init__(self, storage: Storage, max_maps: int) -> None:
        self._storage = storage
        self._max_maps = max_maps
        self._records: dict[str, MapRecord] = {}
        self._last_revisions: dict[str, int] = {}
        self._num_coming = 0
        # Each lives for as long as somebody holds it or waits for it.
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._under_way: set[asyncio.Task[Any]] = set()

    async def load(self) -> None:
        """Read all records; one that cannot be read is logged and left alone."""
        await asyncio.to_thread(self._storage.tidy)
        for map_id in await asyncio.to_thread(self._storage.names, "maps"):
            try:
                record = await asyncio.to_thread(read_record, self._storage, map_id)
            except StorageError as error:
                # Never deleted here: it may be a scan that somebody wants back.
                _log.error("a folder of maps is left alone, its record cannot be read", map_id=map_id, error=str(error))
                continue
            self._records[map_id] = record
            await self._remove_forgotten_revisions(record)

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

    def num_by_status(self) -> Counter[str]:
        """Count the maps by what became of their newest revision."""
        return Counter(record.newest.status for record in self._records.values())

    def next_revision(self, map_id: str) -> MapRef:
        """Return a reference that nobody else gets, also when two scans of a map are uploaded at the same time."""
        last = max(self._last_revisions.get(map_id, 0), self.get(map_id).newest.number)
        self._last_revisions[map_id] = last + 1
        return MapRef(map_id, last + 1)

    def check_room(self) -> None:
        """Raise MapLimitError when there are as many maps as allowed."""
        if len(self._records) + self._num_coming >= self._max_maps:
            raise MapLimitError(
                f"expected fewer than {self._max_maps} maps (PANOLOC_MAX_MAPS), got as many; delete one you do not need"
            )

    def holds(self, ref: MapRef) -> bool:
        """Tell whether the record of a map names this revision, so that its files are kept."""
        record = self._records.get(ref.id)
        return record is not None and record.revision(ref.revision) is not None

    async def adopt_scan(self, ref: MapRef, name: str, file: Path, digest: str) -> str:
        """Take over the scan of a revision that a record will name, and return its key; see `Storage.adopt`.

        When there is no such record in the end, `remove_revision` takes the scan away again.
        """
        key = key_of(ref, name)
        await self._in_turn(ref.id, asyncio.to_thread(self._storage.adopt, key, file, digest))
        return key

    async def counted_bytes(self, revision: Revision) -> int:
        """Return how large a scan is for the limits of its registration."""
        return await asyncio.to_thread(counted_bytes, self._storage, revision)

    async def put_files(self, ref: MapRef, files: Mapping[str, bytes]) -> None:
        """Store files of a revision by name. Raises MapNotFoundError when it was replaced or deleted meanwhile."""

        async def put() -> None:
            if not self.holds(ref):
                raise MapNotFoundError(
                    f"expected a revision that is kept, got {ref.id} revision {ref.revision}; too late"
                )
            for name, data in files.items():
                await asyncio.to_thread(self._storage.put, key_of(ref, name), data)

        await self._in_turn(ref.id, put())

    async def add(self, record: MapRecord) -> None:
        """Store a new map. Raises MapLimitError."""

        async def add() -> None:
            self.check_room()
            self._num_coming += 1
            try:
                await self._write(record)
            finally:
                self._num_coming -= 1

        await self._in_turn(record.id, add())

    async def change(self, map_id: str, update: Callable[[MapRecord], MapRecord]) -> MapRecord:
        """Store what `update` makes of a map, and return it. Raises MapNotFoundError."""

        async def change() -> MapRecord:
            record = update(self.get(map_id))
            if record != self.get(map_id):
                record = replace(record, updated_at=now())
                await self._write(record)
            return record

        return await self._in_turn(map_id, change())

    async def remove(self, map_id: str) -> None:
        """Delete a map with everything stored of it. Raises MapNotFoundError."""

        async def remove() -> None:
            record = self.get(map_id)
            del self._records[map_id]
            try:
                await asyncio.to_thread(self._storage.delete_all, folder_of(map_id))
            except BaseException:
                self._records[map_id] = record
                raise
            self._last_revisions.pop(map_id, None)

        await self._in_turn(map_id, remove())

    async def remove_revision(self, ref: MapRef) -> None:
        """Delete the files of a revision unless the record names it; without a record, what is left of the map."""

        async def remove() -> None:
            if not self.holds(ref):
                prefix = f"{folder_of(ref.id)}/{ref.revision}" if self.has(ref.id) else folder_of(ref.id)
                await asyncio.to_thread(self._storage.delete_all, prefix)

        await self._in_turn(ref.id, remove())

    async def _write(self, record: MapRecord) -> None:
        await asyncio.to_thread(write_record, self._storage, record)
        self._records[record.id] = record

    async def _in_turn(self, map_id: str, work: Coroutine[Any, Any, Result]) -> Result:
        """Do one thing at a time to a map, to its end even when the caller goes away: memory and storage agree."""
        turn = self._turns.setdefault(map_id, asyncio.Lock())

        async def in_turn() -> Result:
            async with turn:
                return await work

        task = asyncio.create_task(in_turn())
        self._under_way.add(task)
        task.add_done_callback(self._under_way.discard)
        return await asyncio.shield(task)

    async def _remove_forgotten_revisions(self, record: MapRecord) -> None:
        for name in await asyncio.to_thread(self._storage.names, folder_of(record.id)):
            if name.isdigit() and record.revision(int(name)) is None:
                await self.remove_revision(MapRef(record.id, int(name)))


def encode_cursor(created_at: str, map_id: str) -> str:
    """Return the place after a map as text that survives a URL."""
    return base64.urlsafe_b64encode(json.dumps([created_at, map_id]).encode()).decode().rstrip("=")


def decode_cursor(cursor: str) -> tuple[str, str]:
    """Return what `encode_cursor` was given. Raises InvalidOptionsError."""
    try:
        padded = cursor.encode("ascii") + b"=" * (-len(cursor) % 4)
        created_at, map_id = json.loads(base64.b64decode(padded, altchars=b"-_", validate=True))
        if isinstance(created_at, str) and isinstance(map_id, str):
            return created_at, map_id
    except (ValueError, TypeError, binascii.Error, RecursionError):
        pass
    message = f"expected the next_cursor of an earlier page, got {cursor[:80]!r}; begin again without a cursor"
    raise InvalidOptionsError(f"cursor: {message}", [{"field": "cursor", "message": message}])


def _order(record: MapRecord) -> tuple[str, str]:
    return record.created_at, record.id
