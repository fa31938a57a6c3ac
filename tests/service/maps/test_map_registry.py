"""Records in memory and in storage, and the pages made of them."""

import asyncio
import hashlib
import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from panoloc.service.errors import InvalidOptionsError, MapLimitError, MapNotFoundError, StoredFileDamagedError
from panoloc.service.jobs import MapRef, RegisterOptions
from panoloc.service.maps.known_maps import decode_cursor, encode_cursor
from panoloc.service.maps.record import MapRecord, Revision, key_of, read_record
from panoloc.service.maps.registry import MapRegistry
from panoloc.service.sharing.locks import FolderLocks
from panoloc.service.storage import FolderStorage

pytestmark = pytest.mark.anyio

REVISION = Revision(1, "maps/m/1/scan.ply", "scan.ply", 10, "00", RegisterOptions())


def record(name: str, created_at: str = "2026-01-01T00:00:00.000000Z", tags: tuple[str, ...] = ()) -> MapRecord:
    return MapRecord(name, name, created_at, created_at, REVISION, tags=list(tags))


async def loaded(folder: Path, max_maps: int = 100) -> MapRegistry:
    registry = MapRegistry(FolderStorage(folder), max_maps)
    await registry.load()
    return registry


@pytest.fixture
async def registry(tmp_path: Path, anyio_backend: str) -> MapRegistry:
    return await loaded(tmp_path)


@pytest.fixture
def storage(tmp_path: Path) -> FolderStorage:
    return FolderStorage(tmp_path)


@given(st.text(), st.text())
def test_a_cursor_survives_its_way_through_a_url(created_at: str, map_id: str) -> None:
    cursor = encode_cursor(created_at, map_id)
    assert cursor.isascii()
    assert not set(cursor) & set("+/=&?#% ")
    assert decode_cursor(cursor) == (created_at, map_id)


@given(st.text())
def test_a_cursor_that_we_did_not_make_is_refused_or_harmless(cursor: str) -> None:
    try:
        place = decode_cursor(cursor)
    except InvalidOptionsError:
        return
    assert [type(part) for part in place] == [str, str]


@settings(max_examples=50)
@given(
    times=st.lists(st.integers(0, 5), max_size=12),
    limit=st.integers(1, 5),
    gone=st.sets(st.integers(0, 11)),
)
def test_pages_show_every_map_that_stays_once_and_in_order(times: list[int], limit: int, gone: set[int]) -> None:
    registry = MapRegistry(FolderStorage(Path("unused")), 100)
    registry._records |= {f"map_{n:02}": record(f"map_{n:02}", f"2026-01-0{time + 1}") for n, time in enumerate(times)}
    expected = [each.id for each in registry.all() if int(each.id[4:]) not in gone]
    seen, cursor, first = [], None, True
    while first or cursor is not None:
        page, cursor = registry.page(None, limit, cursor)
        assert len(page) <= limit
        seen += [each.id for each in page]
        if first:
            first = False
            for number in gone:
                registry._records.pop(f"map_{number:02}", None)
    assert [map_id for map_id in seen if int(map_id[4:]) not in gone] == expected
    assert len(seen) == len(set(seen))


async def test_what_is_written_is_there_after_a_restart(registry: MapRegistry, tmp_path: Path) -> None:
    await registry.add(record("map_a", tags=("x",)))
    await registry.change("map_a", lambda each: replace(each, name="ähnlich"))
    again = await loaded(tmp_path)
    assert again.get("map_a") == registry.get("map_a")
    assert again.get("map_a").name == "ähnlich"
    assert again.get("map_a").updated_at > again.get("map_a").created_at
    assert [each.id for each in again.with_tag("x")] == ["map_a"]


async def test_a_record_that_was_changed_by_hand_is_left_out_and_the_others_serve(
    registry: MapRegistry, storage: FolderStorage, tmp_path: Path
) -> None:
    for name in ("map_a", "map_b"):
        await registry.add(record(name))
    file = tmp_path / "maps/map_a/map.json"
    document = json.loads(file.read_text())
    document["record"]["newest"]["scan_key"] = "maps/map_b/1/scan.ply"
    file.write_text(json.dumps(document))
    assert [each.id for each in (await loaded(tmp_path)).all()] == ["map_b"]
    with pytest.raises(StoredFileDamagedError, match="its digest differs"):
        read_record(storage, "map_a")


async def test_revisions_that_no_record_names_are_removed_at_the_start(
    registry: MapRegistry, storage: FolderStorage, tmp_path: Path
) -> None:
    await registry.add(record("map_a"))
    for number in (1, 2):
        storage.put(key_of(MapRef("map_a", number), "scan.ply"), b"x")
    await loaded(tmp_path)
    assert storage.names("maps/map_a") == ["1", "map.json"]


@pytest.mark.parametrize("is_shared", [False, True])
async def test_a_start_removes_uploads_that_a_crash_left_unless_another_process_may_be_at_them(
    storage: FolderStorage, tmp_path: Path, is_shared: bool
) -> None:
    (upload := storage.spool_folder() / "half").write_bytes(b"half")
    await MapRegistry(storage, 10, FolderLocks(tmp_path / "locks") if is_shared else None).load()
    assert upload.exists() == is_shared


async def adopt_scan(registry: MapRegistry, storage: FolderStorage) -> None:
    (scan := storage.spool_folder() / "upload").write_bytes(b"a scan")
    await registry.adopt_scan(MapRef("map_a", 1), "scan.ply", scan, hashlib.sha256(b"a scan").hexdigest())


async def go_away_while_a_map_is_added(registry: MapRegistry) -> None:
    adding = asyncio.create_task(registry.add(record("map_a")))
    await asyncio.sleep(0)
    adding.cancel()
    with pytest.raises(asyncio.CancelledError):
        await adding


async def test_a_caller_who_goes_away_does_not_part_memory_from_storage(registry: MapRegistry, tmp_path: Path) -> None:
    await go_away_while_a_map_is_added(registry)
    # Whoever changes the same map next waits for the one whose caller is gone.
    await registry.change("map_a", lambda each: replace(each, name="changed"))
    assert registry.get("map_a").name == "changed"
    assert [each.id for each in registry.all()] == [each.id for each in (await loaded(tmp_path)).all()]


async def test_a_caller_who_goes_away_takes_nothing_along_that_the_record_names(
    registry: MapRegistry, storage: FolderStorage
) -> None:
    await adopt_scan(registry, storage)
    await go_away_while_a_map_is_added(registry)
    await registry.remove_revision(MapRef("map_a", 1))
    assert registry.get("map_a") == replace(record("map_a"), version=1)
    assert storage.read("maps/map_a/1/scan.ply") == b"a scan"


async def test_a_scan_that_no_record_came_to_name_is_taken_away_with_its_folder(
    registry: MapRegistry, storage: FolderStorage
) -> None:
    await adopt_scan(registry, storage)
    await registry.remove_revision(MapRef("map_a", 1))
    assert storage.names("maps") == []


async def test_a_map_that_cannot_be_deleted_is_still_there(
    registry: MapRegistry, monkeypatch: pytest.MonkeyPatch
) -> None:
    await registry.add(record("map_a"))

    def refuse(*_: object) -> None:
        raise PermissionError("read-only")

    monkeypatch.setattr(FolderStorage, "delete_all", refuse)
    with pytest.raises(PermissionError):
        await registry.remove("map_a")
    assert registry.get("map_a") == replace(record("map_a"), version=1)


async def test_files_of_a_revision_that_was_replaced_are_not_written(
    registry: MapRegistry, storage: FolderStorage
) -> None:
    await registry.add(record("map_a"))
    await registry.change("map_a", lambda each: replace(each, newest=replace(REVISION, number=2)))
    with pytest.raises(MapNotFoundError, match="map_a revision 1"):
        await registry.put_files(MapRef("map_a", 1), {"preview.png": b"x"})
    assert storage.names("maps/map_a") == ["map.json"]


async def test_pages_of_a_tag_show_the_maps_that_bear_it(registry: MapRegistry) -> None:
    for number in range(6):
        tags = ("even",) if number % 2 == 0 else ("odd", "other")
        await registry.add(record(f"map_{number}", f"2026-01-0{number + 1}", tags))
    first, cursor = registry.page("even", 2, None)
    assert [each.id for each in first] == ["map_0", "map_2"]
    second, end = registry.page("even", 2, cursor)
    assert [each.id for each in second] == ["map_4"]
    assert end is None
    assert registry.page("none", 2, None) == ([], None)
    assert len(registry.page(None, 9, None)[0]) == 6


@pytest.mark.parametrize("max_maps", [1, 2])
async def test_maps_that_come_at_the_same_time_do_not_share_the_last_place(tmp_path: Path, max_maps: int) -> None:
    registry = await loaded(tmp_path, max_maps)
    names = ["map_a", "map_b", "map_c"]
    found = await asyncio.gather(*(registry.add(record(name)) for name in names), return_exceptions=True)
    assert [type(each) for each in found] == [MapRecord] * max_maps + [MapLimitError] * (3 - max_maps)
    assert FolderStorage(tmp_path).names("maps") == names[:max_maps]
    await registry.remove("map_a")
    await registry.add(record("map_c"))
    with pytest.raises(MapLimitError, match="PANOLOC_MAX_MAPS"):
        await registry.add(record("map_a"))
