"""Processes whose locks have expired unnoticed: no change is lost, and nothing that was deleted comes back."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import pytest

from panoloc.core.options import IndexOptions, ScanOptions
from panoloc.service.errors import CacheDownError, MapNotFoundError, VersionConflictError
from panoloc.service.jobs import MapRef, RegisterOptions
from panoloc.service.maps.record import MapRecord, Revision
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.sharing.locks import OwnLocks
from panoloc.service.storage.bucket import BucketStorage
from tests.service.storage.bucket_server import BucketServer

pytestmark = pytest.mark.anyio

REF = MapRef("map_0123456789abcdef", 1)


class NoLocks(OwnLocks):
    """Exclude nobody, like expired leases."""

    is_shared = True
    unsure: ClassVar[set[str]] = set()

    def is_sure(self, name: str) -> bool:
        return name not in self.unsure


@pytest.fixture
def process(bucket_server: BucketServer, prefix: str, tmp_path: Path) -> Callable[[], MapRegistry]:
    """Return what makes the registry of another process."""
    return lambda: MapRegistry(bucket_server.storage(tmp_path, prefix), 10, NoLocks())


def record(name: str = "a map") -> MapRecord:
    revision = Revision(1, "maps/m/1/scan.ply", "scan.ply", 1, "0" * 64, RegisterOptions(ScanOptions(), IndexOptions()))
    return MapRecord(REF.id, name, "2026-01-01T00:00:00Z", "2026-01-01T00:00:00Z", revision, tags=[])


async def test_changes_at_the_same_time_all_hold(process: Callable[[], MapRegistry]) -> None:
    registries = [process() for _ in range(3)]
    await registries[0].add(record())

    async def add_tag(registry: MapRegistry, tag: str) -> None:
        await registry.find([REF.id])
        await registry.change(REF.id, lambda found: replace(found, tags=[*found.tags, tag]))

    tags = [f"{number} {n}" for number in range(3) for n in range(4)]
    await asyncio.gather(*(add_tag(registries[int(tag[0])], tag) for tag in tags))
    after = process()
    await after.load()
    assert sorted(after.get(REF.id).tags) == tags


async def test_of_two_that_name_the_version_one_wins(process: Callable[[], MapRegistry]) -> None:
    one, other = process(), process()
    version = (await one.add(record())).version
    await other.find([REF.id])
    changes = (
        each.change(REF.id, lambda found, name=name: replace(found, name=name), version)  # type: ignore[misc]
        for each, name in ((one, "of one"), (other, "of the other"))
    )
    ends = await asyncio.gather(*changes, return_exceptions=True)
    assert sorted((type(each) for each in ends), key=str) == [VersionConflictError, MapRecord]


async def test_a_change_that_comes_after_a_deletion_brings_nothing_back(
    process: Callable[[], MapRegistry], bucket: BucketStorage
) -> None:
    registry = process()
    await registry.add(record())

    def update(found: MapRecord) -> MapRecord:
        bucket.delete_all(f"maps/{REF.id}")  # by another process, a moment before this one writes
        return replace(found, name="changed")

    with pytest.raises(MapNotFoundError):
        await registry.change(REF.id, update)
    assert not registry.has(REF.id)
    assert bucket.names("maps") == []


async def test_a_change_begins_with_what_another_process_has_made_of_the_map(
    process: Callable[[], MapRegistry],
) -> None:
    one, other = process(), process()
    await one.add(record())
    await other.find([REF.id])
    version = (await one.change(REF.id, lambda found: replace(found, name="of one"))).version
    changed = await other.change(REF.id, lambda found: replace(found, tags=[found.name]), version)
    assert changed.tags == ["of one"]


async def test_nothing_is_deleted_while_a_lock_is_in_doubt(
    process: Callable[[], MapRegistry], bucket: BucketStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    new = MapRef(REF.id, 2)
    map_lock, scan_lock = f"map-{REF.id}", f"scan-{REF.id}-2"
    registry = process()
    await registry.add(record())
    bucket.put(f"maps/{REF.id}/2/scan.ply", b"of another process")
    remove, remove_revision = partial(registry.remove, REF.id), partial(registry.remove_revision, new)
    for unsure, delete in ((map_lock, remove), (map_lock, remove_revision), (scan_lock, remove_revision)):
        monkeypatch.setattr(NoLocks, "unsure", {unsure})
        with pytest.raises(CacheDownError, match="renewed in time"):
            await delete()
    with pytest.raises(CacheDownError, match="renewed in time"):
        registry.check_new_revision(new)
    monkeypatch.setattr(NoLocks, "unsure", set())
    assert registry.has(REF.id)
    await registry.remove_revision(new)
    assert bucket.names(f"maps/{REF.id}") == ["map.json"]
