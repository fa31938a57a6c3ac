"""Processes whose locks have expired unnoticed: no change is lost, and nothing that was deleted comes back."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from core.options import IndexOptions, ScanOptions
from service.errors import CacheDownError, MapNotFoundError, VersionConflictError
from service.jobs import MapRef, RegisterOptions
from service.maps.record import MapRecord, Revision
from service.maps.registry import MapRegistry
from service.sharing.locks import OwnLocks
from service.storage.bucket import BucketStorage
from tests.service.storage.bucket_server import BucketServer

REF = MapRef("map_0123456789abcdef", 1)


class NoLocks(OwnLocks):
    """Exclude nobody, like expired leases."""

    is_shared = True
    sure = True

    def is_sure(self, name: str) -> bool:
        return self.sure


@pytest.fixture
def process(bucket_server: BucketServer, prefix: str, tmp_path: Path) -> Callable[[], MapRegistry]:
    """Return what makes the registry of another process."""
    return lambda: MapRegistry(bucket_server.storage(tmp_path, prefix), 10, NoLocks())


def record(name: str = "a map") -> MapRecord:
    revision = Revision(1, "maps/m/1/scan.ply", "scan.ply", 1, "0" * 64, RegisterOptions(ScanOptions(), IndexOptions()))
    return MapRecord(REF.id, name, "2026-01-01T00:00:00Z", "2026-01-01T00:00:00Z", revision, tags=[])


def test_changes_at_the_same_time_all_hold(process: Callable[[], MapRegistry]) -> None:
    async def change_all() -> list[str]:
        registries = [process() for _ in range(3)]
        await registries[0].add(record())

        async def add_tag(registry: MapRegistry, tag: str) -> None:
            await registry.find([REF.id])
            await registry.change(REF.id, lambda found: replace(found, tags=[*found.tags, tag]))

        await asyncio.gather(
            *(add_tag(each, f"{number} {n}") for number, each in enumerate(registries) for n in range(4))
        )
        after = process()
        await after.load()
        return sorted(after.get(REF.id).tags)

    assert asyncio.run(change_all()) == sorted(f"{number} {n}" for number in range(3) for n in range(4))


def test_of_two_that_name_the_version_one_wins(process: Callable[[], MapRegistry]) -> None:
    async def change_both() -> list[type]:
        one, other = process(), process()
        version = (await one.add(record())).version
        await other.find([REF.id])
        changes = (
            each.change(REF.id, lambda found, name=name: replace(found, name=name), version)  # type: ignore[misc]
            for each, name in ((one, "of one"), (other, "of the other"))
        )
        return sorted((type(each) for each in await asyncio.gather(*changes, return_exceptions=True)), key=str)

    assert asyncio.run(change_both()) == [VersionConflictError, MapRecord]


def test_a_change_that_comes_after_a_deletion_brings_nothing_back(
    process: Callable[[], MapRegistry], bucket: BucketStorage
) -> None:
    async def change_what_goes() -> None:
        registry = process()
        await registry.add(record())

        def update(found: MapRecord) -> MapRecord:
            bucket.delete_all(f"maps/{REF.id}")  # by another process, a moment before this one writes
            return replace(found, name="changed")

        with pytest.raises(MapNotFoundError):
            await registry.change(REF.id, update)
        assert not registry.has(REF.id)

    asyncio.run(change_what_goes())
    assert bucket.names("maps") == []


def test_nothing_is_deleted_while_a_lock_is_in_doubt(process: Callable[[], MapRegistry], bucket: BucketStorage) -> None:
    async def try_to_delete() -> None:
        registry = process()
        await registry.add(record())
        bucket.put(f"maps/{REF.id}/2/scan.ply", b"of another process")
        NoLocks.sure = False
        try:
            for deletion in (registry.remove(REF.id), registry.remove_revision(MapRef(REF.id, 2))):
                with pytest.raises(CacheDownError, match="renewed in time"):
                    await deletion
            with pytest.raises(CacheDownError, match="renewed in time"):
                registry.check_new_revision(MapRef(REF.id, 2))
        finally:
            NoLocks.sure = True
        assert registry.has(REF.id)
        await registry.remove_revision(MapRef(REF.id, 2))

    asyncio.run(try_to_delete())
    assert bucket.names(f"maps/{REF.id}") == ["map.json"]
