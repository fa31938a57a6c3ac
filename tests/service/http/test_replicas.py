"""Two API replicas in this process, over one folder or bucket and one Redis: each knows what the other does, and nothing is done twice."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, AsyncExitStack, contextmanager
from pathlib import Path

import pytest
import redis

from panoloc.service.host.embedded_redis import EmbeddedRedis
from panoloc.service.sharing.change_signal import ChangeSignal
from tests.service.http.running_service import RunningService, running_service
from tests.service.storage.bucket_server import BUCKET

pytestmark = pytest.mark.anyio

Replicas = tuple[RunningService, RunningService]


_LOOK_S = 0.1
Opened = Callable[[], AbstractAsyncContextManager[RunningService]]


@pytest.fixture(params=["folder", "bucket"])
def opened(
    request: pytest.FixtureRequest, tmp_path: Path, redis_server: EmbeddedRedis, redis_client: "redis.Redis"
) -> Opened:
    """Return what opens another API replica: on the folder of the others, or on a machine of its own that shares a bucket with them."""
    numbers = itertools.count()
    request.getfixturevalue("monkeypatch").setattr("panoloc.service.services.LOOK_S", _LOOK_S)
    if request.param == "folder":
        return lambda: running_service(tmp_path, redis_server.url, shared=True)
    server, prefix = request.getfixturevalue("bucket_server"), request.getfixturevalue("prefix")
    patch = request.getfixturevalue("monkeypatch")
    for name, value in server.variables.items():
        patch.setenv(name, value)
    if request.node.callspec.params.get("is_notified") is False:
        patch.setattr("panoloc.service.services._LOOK_INTO_BUCKET_S", 0.5)

    def on_its_own_machine() -> AbstractAsyncContextManager[RunningService]:
        folder, url = tmp_path / f"machine-{next(numbers)}", f"s3://{BUCKET}/{prefix}"
        return running_service(folder, redis_server.url, shared=True, storage=url)

    return on_its_own_machine


@pytest.fixture
async def replicas(opened: Opened, anyio_backend: str) -> AsyncIterator[Replicas]:
    async with opened() as first, opened() as second:
        yield first, second


@contextmanager
def taking_nothing_up(replica: RunningService) -> Iterator[None]:
    """Let an API replica wait for its workers, so that what comes in is the other one's."""
    replica.pool.is_ready = False
    yield
    replica.pool.is_ready = True


async def registering(replicas: Replicas) -> str:
    """Let the first register a map without end, and return its id."""
    first, second = replicas
    first.pool.register_gate.clear()
    with taking_nothing_up(second):
        map_id = str((await first.upload()).json()["id"])
        await until(lambda: bool(first.pool.registrations))
    return map_id


async def localizing(replicas: Replicas, *names: str) -> str:
    """Let the first work at a batch without end, and return its id."""
    first, second = replicas
    map_id = await first.ready_map()
    first.pool.localize_gate.clear()
    with taking_nothing_up(second):
        batch = str((await first.post_batch(map_id, *names)).json()["id"])
        assert (await second.json(f"/batches/{batch}"))["num_images"] == len(names)
        await first.pool.asked.wait()
    return batch


async def until(holds: Callable[[], bool]) -> None:
    """Wait until it holds, for as long as a busy machine may take."""
    async with asyncio.timeout(90):
        while not holds():
            await asyncio.sleep(0.01)


async def test_a_map_posted_through_one_is_served_by_the_other_at_once(replicas: Replicas) -> None:
    first, second = replicas
    map_id = (await first.upload()).json()["id"]
    assert await second.status("GET", f"/maps/{map_id}") == 200
    assert (await second.settled(map_id))["status"] == "ready"
    assert (await second.localize(map_id)).json()["status"] == "localized"
    assert [each["id"] for each in (await second.json("/maps"))["items"]] == [map_id]


@pytest.mark.slow
@pytest.mark.parametrize("is_notified", [True, False])
async def test_what_one_changes_the_other_shows(
    replicas: Replicas, is_notified: bool, redis_client: "redis.Redis", monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = replicas
    map_id = await first.ready_map()
    await second.settled(map_id)
    if not is_notified:

        async def publish_nothing(signal: ChangeSignal, map_id: str) -> None:
            """Be a Redis that is away."""

        for replica in replicas:
            registry = replica.app.state.services.registry
            registry.publish = publish_nothing.__get__(registry)
        redis_client.flushall()
    assert (await first.client.patch(f"/maps/{map_id}", json={"name": "changed"})).status_code == 200
    # The list is what is known: nothing is looked at for it.
    await second.eventually("/maps", lambda body: [each["name"] for each in body["items"]] == ["changed"])
    await first.client.delete(f"/maps/{map_id}")
    await second.eventually("/maps", lambda body: body["items"] == [])
    assert (await second.localize(map_id)).status_code == 404


@pytest.mark.parametrize("opened", ["folder"], indirect=True)
async def test_what_another_has_just_made_is_found_by_its_id_before_it_is_announced(replicas: Replicas) -> None:
    first, second = replicas
    await second.app.state.services.shared_folder.stop()
    map_id = await first.ready_map()
    assert (await second.localize(map_id)).json()["status"] == "localized"
    other_id = await first.ready_map()
    assert await second.status("GET", f"/maps/{other_id}/preview.png") == 200
    third_id = await first.ready_map()
    reply = await second.post_batch(third_id, "a.png")
    assert reply.status_code == 202
    batch = (await first.post_batch(map_id, "a.png")).json()["id"]
    assert await second.status("GET", f"/batches/{batch}") == 200


async def test_of_two_changes_at_once_that_name_the_version_one_wins_and_the_other_is_notified(
    replicas: Replicas,
) -> None:
    first, second = replicas
    map_id = await first.ready_map()
    tag = (await second.client.get(f"/maps/{map_id}")).headers["etag"]
    replies = await asyncio.gather(
        *(
            replica.client.patch(f"/maps/{map_id}", json={"name": name}, headers={"If-Match": tag})
            for replica, name in zip(replicas, ("one", "two"), strict=True)
        )
    )
    assert sorted(reply.status_code for reply in replies) == [200, 412]
    (won,), (refused,) = ([reply for reply in replies if reply.status_code == status] for status in (200, 412))
    assert refused.json()["type"] == "/problems/version-conflict"
    assert won.headers["etag"] != tag
    for replica in replicas:
        await replica.eventually(f"/maps/{map_id}", lambda body: body == won.json())
    again = await second.client.patch(
        f"/maps/{map_id}", json={"name": "three"}, headers={"If-Match": won.headers["etag"]}
    )
    assert again.status_code == 200


@pytest.mark.parametrize("opened", ["folder"], indirect=True)
async def test_a_version_that_is_none_is_refused(replicas: Replicas) -> None:
    map_id = await replicas[0].ready_map()
    reply = await replicas[1].client.patch(f"/maps/{map_id}", json={"name": "x"}, headers={"If-Match": '"abc"'})
    assert reply.status_code == 422
    assert "If-Match" in reply.json()["detail"]
    reply = await replicas[1].client.patch(f"/maps/{map_id}", json={"name": "x"}, headers={"If-Match": "*"})
    assert reply.status_code == 200


@pytest.mark.slow
async def test_a_registration_is_done_by_one_of_them(replicas: Replicas) -> None:
    for replica in replicas:
        replica.pool.register_gate.clear()
    map_ids = {(await replica.upload()).json()["id"] for replica in replicas for _ in range(3)}
    # Time for each to look more than once.
    await asyncio.sleep(3 * _LOOK_S)
    for replica in replicas:
        replica.pool.register_gate.set()
    for map_id in map_ids:
        assert (await replicas[0].settled(map_id))["status"] == "ready"
    await asyncio.sleep(3 * _LOOK_S)
    registered = [job.map.id for replica in replicas for job in replica.pool.registrations]
    assert sorted(registered) == sorted(map_ids)


@pytest.mark.slow
async def test_a_replica_that_leaves_hands_its_registrations_over(opened: Opened) -> None:
    async with opened() as stays:
        async with opened() as leaves:
            leaves.pool.register_gate.clear()
            with taking_nothing_up(stays):
                map_id = (await leaves.upload()).json()["id"]
                await until(lambda: bool(leaves.pool.registrations))
            assert stays.pool.registrations == []
        assert (await stays.settled(map_id))["status"] == "ready"
        assert [job.map.id for job in stays.pool.registrations] == [map_id]


async def test_a_registration_whose_map_another_deletes_ends_and_leaves_nothing(replicas: Replicas) -> None:
    first, second = replicas
    map_id = await registering(replicas)
    assert await second.status("DELETE", f"/maps/{map_id}") == 204
    await until(lambda: first.pool.ended == ["register"])
    await until(lambda: first.storage.names("maps") == [])
    assert first.app.state.services.registry.all() == []


@pytest.mark.parametrize("opened", ["folder"], indirect=True)
async def test_scans_of_a_map_that_come_through_both_at_once_are_revisions_of_their_own(replicas: Replicas) -> None:
    map_id = await replicas[0].ready_map()
    replies = await asyncio.gather(*(replica.replace_scan(map_id) for replica in replicas for _ in "ab"))
    assert [reply.status_code for reply in replies] == [202] * 4
    shown = await replicas[0].eventually(f"/maps/{map_id}", lambda body: body["status"] == "ready")
    newest = shown["revision"]
    assert shown["serving_revision"] == newest
    await until(lambda: replicas[0].storage.names(f"maps/{map_id}") == [str(newest), "map.json"])
    await replicas[1].eventually(f"/maps/{map_id}", lambda body: body["serving_revision"] == newest)


@pytest.mark.slow
async def test_one_that_starts_leaves_what_others_are_storing(opened: Opened) -> None:
    async with opened() as first:
        map_id = await first.ready_map()
        upload = first.storage.spool_folder() / "upload-of-the-first"
        upload.write_bytes(b"half of it")
        first.storage.put(f"maps/{map_id}/2/scan.ply", b"its record is about to be written")
        storing = await first.app.state.services.registry._locks.try_hold(f"scan-{map_id}-2")
        assert storing is not None
        async with opened():
            assert upload.exists()
            assert first.storage.names(f"maps/{map_id}") == ["1", "2", "map.json"]
        storing.release()
        async with opened():
            assert first.storage.names(f"maps/{map_id}") == ["1", "map.json"]


@pytest.mark.slow
async def test_a_batch_is_worked_on_by_one_and_shown_by_both(replicas: Replicas) -> None:
    first, second = replicas
    batch = await localizing(replicas, *(f"{number}.png" for number in range(6)))
    await asyncio.sleep(3 * _LOOK_S)
    first.pool.localize_gate.set()
    shown = await second.done(batch)
    assert await second.status("PATCH", f"/batches/{batch}", json={"name": "3rd floor"}) == 200
    await first.eventually("/batches", lambda body: body["items"][0]["name"] == "3rd floor")
    assert shown["counts"]["localized"] == 6
    assert (len(first.pool.jobs), second.pool.jobs) == (6, [])
    await second.eventually("/batches", lambda body: [each["status"] for each in body["items"]] == ["done"])


@pytest.mark.slow
async def test_a_batch_of_a_replica_that_leaves_goes_on_where_it_was(opened: Opened) -> None:
    names = [f"{number}.png" for number in range(4)]
    async with AsyncExitStack() as stack:
        stays = await stack.enter_async_context(opened())
        map_id = await stays.ready_map()
        async with opened() as leaves:
            with taking_nothing_up(stays):
                batch = (await leaves.post_batch(map_id, *names)).json()["id"]
                await until(lambda: bool(leaves.storage.names(f"batches/{batch}/results")))
            leaves.pool.localize_gate.clear()
        num_done = len(stays.storage.names(f"batches/{batch}/results"))
        shown = await stays.done(batch)
        assert shown["counts"]["localized"] == 4
        assert len(stays.pool.jobs) == 4 - num_done


@pytest.mark.parametrize("opened", ["folder"], indirect=True)
@pytest.mark.slow
async def test_a_batch_that_another_deletes_ends_and_leaves_nothing(replicas: Replicas) -> None:
    first, second = replicas
    batch = await localizing(replicas, *(f"{number}.png" for number in range(4)))
    assert await second.status("DELETE", f"/batches/{batch}") == 204
    await until(lambda: first.pool.ended == ["localize"])
    await until(lambda: not first.app.state.services.batches.has(batch))
    assert await first.status("GET", f"/batches/{batch}") == 404
    assert first.storage.names("batches") == []


@pytest.mark.parametrize("opened", ["folder"], indirect=True)
async def test_a_result_that_comes_after_another_deleted_its_batch_is_not_written(replicas: Replicas) -> None:
    first, second = replicas
    map_id = await first.ready_map()
    first.pool.localize_gate.clear()
    batch = (await first.post_batch(map_id, "a.png")).json()["id"]
    await second.app.state.services.batches.refresh()
    await second.app.state.services.batches.remove(batch)
    await first.app.state.services.batches.put_result(batch, 0, {"status": "failed", "error": {}})
    assert first.storage.names("batches") == []


@pytest.mark.parametrize("opened", ["folder"], indirect=True)
async def test_answers_can_be_fetched_through_the_other(replicas: Replicas) -> None:
    first, second = replicas
    map_id = await first.ready_map()
    reply = await first.localize(map_id, headers={"Prefer": "respond-async"})
    assert reply.status_code == 202
    answer = await second.eventually(reply.headers["location"], lambda body: body["status"] == "localized")
    assert answer["map_id"] == map_id


# The kernel takes no file lock from a process that lives.
@pytest.mark.slow
@pytest.mark.parametrize("opened", ["bucket"], indirect=True)
async def test_a_registration_whose_lease_another_has_ends_here(
    replicas: Replicas, redis_client: "redis.Redis"
) -> None:
    first, second = replicas
    first.pool.register_gate.clear()
    with taking_nothing_up(second):
        map_id = (await first.upload()).json()["id"]
        await until(lambda: bool(first.pool.registrations))
        # As it is after this process has stood still for a minute.
        redis_client.set(f"panoloc:lease:register-{map_id}-1", "of another", px=60_000)
        await until(lambda: first.pool.ended == ["register"])
        assert (await first.json(f"/maps/{map_id}"))["status"] not in ("ready", "failed")
    assert redis_client.get(f"panoloc:lease:register-{map_id}-1") == "of another"
    redis_client.delete(f"panoloc:lease:register-{map_id}-1")
    first.pool.register_gate.set()
    assert (await first.settled(map_id))["status"] == "ready"
