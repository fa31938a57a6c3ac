"""What the pool of this machine does beyond the contract, with real processes and a scripted worker."""

import asyncio
import itertools
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from panoloc.core.config import SearchConfig
from panoloc.lab.process_memory import command_of, descendants
from panoloc.service.errors import NoWorkerError, StoredFileDamagedError
from panoloc.service.pool import process_pool, worker_process
from panoloc.service.pool.forked_process import ForkServer
from panoloc.service.pool.process_pool import local_pool
from panoloc.service.settings import Settings
from tests.integration.running_service import eventually, is_running
from tests.service.pool.pool_in_thread import PoolInThread, query, scripted_plan

pytestmark = [pytest.mark.integration, pytest.mark.filterwarnings("ignore::ResourceWarning")]


@contextmanager
def running_pool(folder: Path, num_workers: int | None = 1) -> Iterator[PoolInThread]:
    settings = Settings(data_dir=folder, num_workers=num_workers)
    running = PoolInThread(folder, local_pool(settings, scripted_plan(folder)))
    try:
        yield running
    finally:
        running.stop(0)


def workers() -> list[int]:
    return [pid for pid in descendants(os.getpid()) if command_of(pid) == "panoloc-worker"]


def test_a_worker_that_hangs_past_its_deadline_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_pool, "_WATCH_PERIOD_S", 0.05)
    monkeypatch.setattr(worker_process, "OVERDUE_S", 0.3)
    with running_pool(tmp_path) as running:
        running.wait_until_ready()
        (hung,) = workers()
        with pytest.raises(Exception, match="no answer within"):
            running.localize(query("hangs", until="never", timeout_s=0.2))
        assert running.localize(query("next")).answer.search["pid"] != hung
        assert not is_running(hung)


def test_a_worker_beyond_its_memory_is_replaced_and_its_query_repeated_until_it_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_pool, "_WATCH_PERIOD_S", 0.05)
    monkeypatch.setattr(process_pool, "usable_memory_bytes", lambda: 250 << 20)
    with running_pool(tmp_path) as running:
        running.wait_until_ready()
        with pytest.raises(NoWorkerError, match="GiB of memory"):
            running.localize(query("greedy", take_mb=300, until="never"))
        assert running.pool.state().num_retries == 3
        assert running.localize(query("modest")).answer.status == "localized"


def test_workers_that_do_not_start_are_told_with_their_reason_until_they_do(tmp_path: Path) -> None:
    (tmp_path / "no-worker-starts").touch()
    with running_pool(tmp_path) as running:
        assert eventually(lambda: "no worker starts in this folder" in (running.pool.state().waiting_for or ""), 30)
        with pytest.raises(NoWorkerError, match="no worker starts in this folder"):
            running.localize(query("refused"))
        (tmp_path / "no-worker-starts").unlink()
        running.wait_until_ready(60)
        assert running.localize(query("answered")).answer.status == "localized"


def test_each_of_several_workers_scores_a_share_of_many_maps_and_one_searches_the_likeliest(
    tmp_path: Path,
) -> None:
    maps = tuple(f"map_{number}" for number in range(90))
    with running_pool(tmp_path, 3) as running:
        assert eventually(lambda: running.pool.state().num_workers == 3, 60)
        scores = {name: float(number % 80) for number, name in enumerate(maps)}
        figures = running.localize(query("many", maps, scores=scores)).answer.search
        shares = [path.read_text().split() for path in tmp_path.glob("*.maps")]
        assert len(shares) == 3
        assert sorted(itertools.chain(*shares)) == sorted(maps)
        assert figures["maps"] == sorted(maps, key=lambda name: -scores[name])[:64]
        assert figures["num_maps"] == 90
        assert running.localize(query("few", maps[:64])).answer.search["maps"] == list(maps[:64])
        # What is found is sought beside maps that look the same, however unlikely these seemed.
        of_view = {"along_walls": True, "scores": {"map_79": 1.0, "map_3": 0.95, "map_5": 0.5}}
        asked = query("equal", maps, scores=scores, found="map_79", view=of_view)
        assert running.localize(asked).answer.search["maps"] == ["map_79", "map_3"]
        asked = query(
            "unequal", maps, scores=scores, found="map_3", view=of_view | {"scores": {"map_3": 1.0, "map_79": 0.5}}
        )
        assert running.localize(asked).answer.search["maps"] == figures["maps"]


def test_of_many_maps_those_that_cannot_be_built_are_left_out_wherever_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_pool, "_SEARCH", SearchConfig(most_maps=4))
    whole, broken = tuple(f"map_{number}" for number in range(4)), ("map_broken_a", "map_broken_b")
    for name in whole:
        (tmp_path / f"{name}.1.index").touch()
    with running_pool(tmp_path, 2) as running:
        assert eventually(lambda: running.pool.state().num_workers == 2, 60)
        job = query("most", (*whole, *broken), needs_index=True, scores={})
        answer = running.localize(job).answer
        assert (answer.status, answer.search["num_maps"]) == ("localized", 4)
        assert sorted(answer.warnings) == [f"{name} was left out: its scan is damaged" for name in broken]
        none = query("none", tuple(f"map_broken_{number}" for number in range(5)), needs_index=True, scores={})
        with pytest.raises(StoredFileDamagedError, match="its scan is damaged"):
            running.localize(none)


def test_queries_that_wait_are_refused_when_the_next_worker_does_not_start(tmp_path: Path) -> None:
    with running_pool(tmp_path) as running:
        running.wait_until_ready()
        waiting = running.begin_localizing(*(query(f"w-{number}", until="never") for number in range(3)))
        assert eventually(lambda: any(tmp_path.glob("w-*.started")), 30)
        (tmp_path / "no-worker-starts").touch()
        os.kill(workers()[0], signal.SIGKILL)
        for each in waiting:
            assert isinstance(each.exception(60), NoWorkerError)


def test_of_two_workers_one_answers_while_the_other_one_is_replaced(tmp_path: Path) -> None:
    with running_pool(tmp_path, num_workers=2) as running:
        assert eventually(lambda: running.pool.state().num_workers == 2, 30)
        pids = set(workers())
        both = running.begin_localizing(*(query(f"b-{number}", until="go") for number in range(2)))
        assert eventually(lambda: len(list(tmp_path.glob("b-*.started"))) == 2, 30)
        os.kill(min(pids), signal.SIGKILL)
        (tmp_path / "go").touch()
        assert [each.result(60).answer.status for each in both] == ["localized"] * 2
        assert eventually(lambda: running.pool.state().num_workers == 2 and len(pids & set(workers())) == 1, 30)


def test_a_fork_server_that_is_killed_ends_what_it_has_forked_and_another_one_starts(tmp_path: Path) -> None:
    with running_pool(tmp_path) as running:
        running.wait_until_ready()
        (begun,) = running.begin_localizing(query("begun", until="go"))
        assert eventually((tmp_path / "begun.started").exists, 30)
        (server,) = [pid for pid in descendants(os.getpid()) if "fork_server" in command_of(pid)]
        (orphan,) = workers()
        os.kill(server, signal.SIGKILL)
        assert eventually(lambda: not is_running(orphan), 30)
        (tmp_path / "go").touch()
        assert begun.result(60).answer.search["pid"] != orphan


def test_starts_that_are_given_up_do_not_end_the_fork_server() -> None:
    async def given_up() -> int:
        server = ForkServer([])
        kept = await server.start("builder")
        for _ in range(5):
            start = asyncio.ensure_future(server.start("builder"))
            await asyncio.sleep(0)
            start.cancel()
        another = await server.start("builder")
        assert is_running(kept.pid)
        for process in (kept, another):
            process.kill()
            assert await process.wait() == -signal.SIGKILL
        await server.stop()
        return another.pid

    assert not is_running(asyncio.run(given_up()))


def test_a_query_goes_to_the_worker_that_has_its_maps(tmp_path: Path) -> None:
    with running_pool(tmp_path, num_workers=2) as running:
        assert eventually(lambda: running.pool.state().num_workers == 2, 30)
        (first,) = running.begin_localizing(query("a-1", maps=("map_a",), until="go"))
        assert eventually((tmp_path / "a-1.started").exists, 30)
        at_b = running.localize(query("b-1", maps=("map_b",))).answer.search["pid"]
        (tmp_path / "go").touch()
        at_a = first.result(60).answer.search["pid"]
        assert at_a != at_b
        for number in range(3):
            assert running.localize(query(f"a-{number}-again", maps=("map_a",))).answer.search["pid"] == at_a
            assert running.localize(query(f"b-{number}-again", maps=("map_b",))).answer.search["pid"] == at_b


def test_every_gpu_has_a_worker_which_sees_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "1,3")
    with running_pool(tmp_path, num_workers=None) as running:
        assert eventually(lambda: running.pool.state().num_workers == 2, 30)
        both = running.begin_localizing(*(query(f"g-{number}", until="go") for number in range(2)))
        assert eventually(lambda: len(list(tmp_path.glob("g-*.started"))) == 2, 30)
        (tmp_path / "go").touch()
        assert sorted(each.result(60).answer.search["gpus"] for each in both) == ["1", "3"]
