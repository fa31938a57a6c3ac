"""All maps of the service: in memory for reading, in storage for good.

The only writer of what is stored of maps. Changes of one map exclude each other, so that no file is written while its
folder is being deleted; different maps do not wait for each other. Where other processes share the storage, a change
excludes theirs too, and begins with a look at what they have made of the map.
"""

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import structlog

from panoloc.service.errors import (
    MapLimitError,
    MapNotFoundError,
    StorageError,
    StoredFileChangedError,
    StoredFileMissingError,
    VersionConflictError,
)
from panoloc.service.jobs import MapRef, now
from panoloc.service.maps.known_maps import VisibleMaps
from panoloc.service.maps.record import MapRecord, folder_of, key_of, read_stamped_record, write_record
from panoloc.service.sharing.change_signal import Publish, publish_nothing
from panoloc.service.sharing.locks import HeldLock, KeyedLock, Locks, OwnLocks
from panoloc.service.storage import Stamp, Storage

Result = TypeVar("Result")

_log = structlog.get_logger(__name__)

_ID = re.compile(r"map_[0-9a-f]{16}")
# Long after whatever a process that still lives has begun.
_LEFT_BEHIND_S = 24 * 3600.0


class MapRegistry(VisibleMaps):
    """Used from one event loop. publish: awaited with the id of each map that this process has changed, made or deleted.

    A change is in storage before it is seen in memory; a deletion is seen first, so that nobody finds a map whose files
    are going.
    """

    def __init__(self, storage: Storage, max_maps: int, locks: Locks | None = None) -> None:
        """locks: of the processes that share the storage; None: there is no other."""
        super().__init__({}, None)
        self._storage = storage
        self._max_maps = max_maps
        self._locks = locks or OwnLocks()
        self._changes = KeyedLock()
        self.publish: Publish = publish_nothing
        self._num_coming = 0
        # Of the records as they were read or written last.
        self._stamps: dict[str, Stamp] = {}

    async def load(self) -> None:
        """Read all records; one that cannot be read is logged and left alone."""
        await asyncio.to_thread(self._storage.tidy, _LEFT_BEHIND_S if self._locks.is_shared else 0.0)
        map_ids = await asyncio.to_thread(self._storage.names, "maps")
        # At the same time: a bucket answers each after a while.
        await asyncio.gather(*(self._load(map_id) for map_id in map_ids))

    async def find(self, map_ids: Iterable[str]) -> None:
        """Look for unknown maps, which another process may have made a moment ago. Raises StorageAwayError."""
        await asyncio.gather(*(self.refresh(each) for each in set(map_ids) if each not in self._records))

    async def refresh(self, map_id: str) -> None:
        """Look what other processes have made of a map; does nothing where there are none."""
        if self._locks.is_shared and (map_id in self._records or _ID.fullmatch(map_id)):
            await self._changes.run(map_id, lambda: self._look(map_id))

    def is_current(self, map_id: str, stamp: Stamp) -> bool:
        """Tell whether a map is known as it is stored."""
        return map_id in self._records and self._stamps.get(map_id) == stamp

    def check_new_revision(self, ref: MapRef) -> None:
        """Raise CacheDownError where the reference of `new_revision` may be another's: before a record names it."""
        self._locks.check_sure(_scan_lock(ref))

    @asynccontextmanager
    async def new_revision(self, map_id: str) -> AsyncIterator[MapRef]:
        """Give a reference that nobody else gets meanwhile, also when two scans of a map are uploaded at the same time.

        For the duration of a block, at the end of which the record names it or its files are removed.
        """
        await self.refresh(map_id)
        number = self.get(map_id).newest.number + 1
        while (lock := await self._locks.try_hold(_scan_lock(MapRef(map_id, number)))) is None:
            number += 1
        try:
            yield MapRef(map_id, number)
        finally:
            lock.release()

    def check_room(self) -> None:
        """Raise MapLimitError when there are as many maps as allowed."""
        if len(self._records) + self._num_coming >= self._max_maps:
            raise MapLimitError(
                f"expected fewer than {self._max_maps} maps (PANOLOC_MAX_MAPS), but the limit is reached; delete a "
                "map that is no longer needed"
            )

    async def adopt_scan(self, ref: MapRef, name: str, file: Path, digest: str) -> str:
        """Take over the scan of a revision that a record will name, and return its key; see `Storage.adopt`.

        When there is no such record in the end, `remove_revision` takes the scan away again.
        """
        key = key_of(ref, name)
        await self._exclusively(ref.id, lambda: asyncio.to_thread(self._storage.adopt, key, file, digest))
        return key

    async def try_register(self, ref: MapRef) -> HeldLock | None:
        """Return the lock on the registration of a revision, None while another process has it.

        Raises StorageFullError, StorageReadOnlyError and CacheDownError.
        """
        return await self._locks.try_hold(f"register-{ref.id}-{ref.revision}")

    async def put_files(self, ref: MapRef, files: Mapping[str, bytes]) -> None:
        """Store files of a revision by name. Raises MapNotFoundError when it was replaced or deleted meanwhile."""

        async def put() -> None:
            if not self.holds(ref):
                raise MapNotFoundError(
                    f"expected a revision that still exists, got {ref.id} revision {ref.revision}, which is deleted"
                )
            for name, data in files.items():
                await asyncio.to_thread(self._storage.put, key_of(ref, name), data)

        await self._exclusively(ref.id, put)

    async def add(self, record: MapRecord) -> MapRecord:
        """Store a new map, and return it. Raises MapLimitError."""

        async def add() -> MapRecord:
            self.check_room()
            self._num_coming += 1
            try:
                return await self._write(record)
            finally:
                self._num_coming -= 1

        return await self._exclusively(record.id, add)

    async def change(
        self, map_id: str, update: Callable[[MapRecord], MapRecord], version: int | None = None
    ) -> MapRecord:
        """Store what `update` makes of a map, and return it.

        version: that the map must have. Raises MapNotFoundError, and VersionConflictError for another version.
        """

        async def change() -> MapRecord:
            while True:
                found = self.get(map_id)
                if version is not None and found.version != version:
                    raise VersionConflictError(
                        f"expected version {version} of {map_id}, but somebody has changed the map to version "
                        f"{found.version}; read the map again"
                    )
                changed = update(found)
                if changed == found:
                    return found
                try:
                    return await self._write(replace(changed, updated_at=now()))
                except StoredFileChangedError:
                    # By a process that had our lock while this one stood still.
                    await self._look(map_id)

        return await self._exclusively(map_id, change)

    async def change_newest(self, ref: MapRef, **changes: object) -> None:
        """Change fields of the newest revision, unless a newer scan has come; one that becomes ready serves."""

        def update(record: MapRecord) -> MapRecord:
            if record.newest_ref != ref:
                return record
            newest = replace(record.newest, **changes)  # type: ignore[arg-type]
            return replace(record, newest=newest, serving=newest if newest.status == "ready" else record.serving)

        await self.change(ref.id, update)

    async def remove(self, map_id: str) -> None:
        """Delete a map with everything stored of it. Raises MapNotFoundError."""

        async def remove() -> None:
            record = self.get(map_id)
            self._locks.check_sure(_map_lock(map_id))
            del self._records[map_id]
            try:
                await asyncio.to_thread(self._storage.delete_all, folder_of(map_id))
            except BaseException:
                self._records[map_id] = record
                raise
            await self.publish(map_id)

        await self._exclusively(map_id, remove)

    async def remove_revision(self, ref: MapRef) -> None:
        """Delete the files of a revision unless the record names it; without a record, what is left of the map."""

        async def remove() -> None:
            if not self.holds(ref):
                for lock in (_map_lock(ref.id), _scan_lock(ref)):
                    self._locks.check_sure(lock)
                prefix = f"{folder_of(ref.id)}/{ref.revision}" if self.has(ref.id) else folder_of(ref.id)
                await asyncio.to_thread(self._storage.delete_all, prefix)

        await self._exclusively(ref.id, remove)

    async def _exclusively(self, map_id: str, work: Callable[[], Awaitable[Result]]) -> Result:
        """Do something to a map as the only one, on what is stored of it, and to its end."""

        async def among_processes() -> Result:
            async with self._locks.held(_map_lock(map_id)):
                if self._locks.is_shared:
                    await self._look(map_id)
                return await work()

        return await self._changes.run(map_id, among_processes)

    async def _write(self, record: MapRecord) -> MapRecord:
        record = replace(record, version=record.version + 1)
        over = self._stamps.get(record.id) if self._locks.is_shared else None
        self._stamps[record.id] = await asyncio.to_thread(write_record, self._storage, record, over)
        self._records[record.id] = record
        await self.publish(record.id)
        return record

    async def _look(self, map_id: str) -> None:
        """Read what is stored of a map; while nothing else is done to it."""
        try:
            found, stamp = await asyncio.to_thread(read_stamped_record, self._storage, map_id)
            self._records[map_id], self._stamps[map_id] = found, stamp
        except StoredFileMissingError:
            self._records.pop(map_id, None)
            self._stamps.pop(map_id, None)
        except StorageError as error:
            _log.error(
                "a map keeps its last known state, because its record cannot be read", map_id=map_id, error=str(error)
            )

    async def _load(self, map_id: str) -> None:
        await self._look(map_id)
        if (record := self._records.get(map_id)) is not None:
            await self._remove_forgotten_revisions(record)
        elif not self._locks.is_shared:  # otherwise another process may store its scan now
            # Never deleted here: it may be a scan that somebody wants back.
            _log.error("a map folder is skipped, because its record is missing or cannot be read", map_id=map_id)

    async def _remove_forgotten_revisions(self, record: MapRecord) -> None:
        for name in await asyncio.to_thread(self._storage.names, folder_of(record.id)):
            if name.isdigit() and record.revision(int(name)) is None:
                ref = MapRef(record.id, int(name))
                # None: another process stores it now.
                if (lock := await self._locks.try_hold(_scan_lock(ref))) is not None:
                    await self.remove_revision(ref)
                    lock.release()


def _map_lock(map_id: str) -> str:
    """Return the lock that is held while something is done to a map."""
    return f"map-{map_id}"


def _scan_lock(ref: MapRef) -> str:
    """Return the lock that is held while the scan of a revision is stored."""
    return f"scan-{ref.id}-{ref.revision}"
