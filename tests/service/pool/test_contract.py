"""What every pool promises, with real processes and a scripted worker: the local one, and one whose workers are on a Ray cluster."""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from panoloc.core.errors import DeadlineExceededError, PanoramaShapeError
from panoloc.lab.process_memory import command_of
from panoloc.service.errors import NoWorkerError, QueueFullError, RegistrationLimitError, StoredFileDamagedError
from panoloc.service.jobs import LocalizeOutcome
from panoloc.service.pool.process_pool import local_pool
from panoloc.service.ray.bridge_pool import BridgePool
from panoloc.service.settings import Settings
from tests.integration.ray_cluster import RayClusterOfOthers
from tests.integration.running_service import ROOT, eventually, is_running
from tests.service.pool.pool_in_thread import PoolInThread, query, registration, scripted_plan

pytestmark = [pytest.mark.integration, pytest.mark.filterwarnings("ignore::ResourceWarning"), pytest.mark.timeout(900)]


_DEPLOY = "import pickle, sys; from panoloc.service.ray.application import deploy"
_DEPLOY += "; deploy(sys.argv[1], pickle.loads(bytes.fromhex(sys.argv[2])))"


@pytest.fixture(scope="module", params=["local", "ray"])
def running(request: pytest.FixtureRequest) -> Iterator[PoolInThread]:
    """A pool with one worker and ten places in its queue."""
    with tempfile.TemporaryDirectory(prefix="pl-") as name:
        folder = Path(name)
        plan = scripted_plan(folder)
        if request.param == "local":
            settings = Settings(data_dir=folder, queue_limit=10, num_workers=1)
            running = PoolInThread(folder, local_pool(settings, plan))
            running.wait_until_ready()
            yield running
            running.stop()
            return
        with RayClusterOfOthers() as cluster:
            # In a process of its own, as `panoloc workers` does it.
            command = [sys.executable, "-c", _DEPLOY, cluster.address, pickle.dumps(plan).hex()]
            subprocess.run(command, cwd=ROOT, check=True, timeout=240)
            settings = Settings(data_dir=folder, queue_limit=10, ray_address=cluster.address)
            running = PoolInThread(folder, BridgePool(settings, plan))
            running.wait_until_ready()
            yield running
            running.stop()


def test_a_query_is_answered_by_another_process(running: PoolInThread) -> None:
    figures = running.localize(query("first")).answer.search
    assert figures["request_id"] == "first"
    assert figures["pid"] != os.getpid()
    state = running.pool.state()
    assert (state.num_workers, state.resident_bytes, state.waiting_for) == (1, 1234, None)


def test_a_worker_killed_with_eight_queries_under_way_costs_no_answer(running: PoolInThread) -> None:
    pid = running.localize(query("before-kill")).answer.search["pid"]
    jobs = [query(f"kill-{number}", until="go") for number in range(8)]
    begun = running.begin_localizing(*jobs)
    assert eventually(lambda: any(running.folder.glob("kill-*.started")), 30)
    os.kill(pid, signal.SIGKILL)
    (running.folder / "go").touch()
    found = [each.result(240).answer.search for each in begun]
    assert [figures["request_id"] for figures in found] == [each.request_id for each in jobs]
    assert any(figures["pid"] != pid for figures in found)
    assert running.pool.state().num_retries >= 1


def test_a_query_that_kills_its_worker_is_tried_again_and_given_up_where_it_always_does(
    running: PoolInThread, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert running.localize(query("crash", crash_once=True)).answer.search["request_id"] == "crash"
    monkeypatch.setattr("panoloc.service.pool.process_pool._MAX_ATTEMPTS", 2)  # Ray takes seconds for each
    with pytest.raises(NoWorkerError, match="2 workers in a row were lost"):
        running.localize(query("crash-always", crash=True))
    assert running.localize(query("after-crashes")).answer.status == "localized"


def test_what_the_worker_raises_on_purpose_is_raised_here_as_well(running: PoolInThread) -> None:
    with pytest.raises(PanoramaShapeError, match="as the script says"):
        running.localize(query("bad", fail="PanoramaShapeError"))


def test_a_full_queue_turns_the_next_query_away(running: PoolInThread) -> None:
    (running.folder / "full-go").unlink(missing_ok=True)
    begun = running.begin_localizing(*(query(f"full-{number}", until="full-go") for number in range(15)))
    assert eventually(lambda: sum(each.done() for each in begun) == 4, 30)
    (running.folder / "full-go").touch()
    outcomes = [each.exception(60) or each.result() for each in begun]
    refused = [outcome for outcome in outcomes if isinstance(outcome, QueueFullError)]
    assert len(refused) == 4
    assert all(error.retry_after_s >= 1 for error in refused)
    assert sum(isinstance(outcome, LocalizeOutcome) for outcome in outcomes) == 11


def test_a_query_past_its_deadline_fails_and_what_had_not_begun_is_dropped(running: PoolInThread) -> None:
    first = running.begin_localizing(*(query(f"slow-{number}", until="slow-go") for number in range(2)))
    assert eventually(lambda: any(running.folder.glob("slow-*.started")), 30)
    for _ in range(60):  # earlier queries took so long that the late one would be refused at the door
        running.pool.admission.note_duration(0.01, "fast")
    with pytest.raises(DeadlineExceededError):
        running.localize(query("late", timeout_s=0.4))
    (running.folder / "slow-go").touch()
    assert [each.result(60).answer.status for each in first] == ["localized"] * 2
    running.localize(query("after"))
    # Ray holds one query more than the worker computes.
    assert not (running.folder / "late.started").exists()


def test_a_query_that_is_cancelled_makes_room_for_the_next(running: PoolInThread) -> None:
    (begun,) = running.begin_localizing(query("given-up", until="never", stops=True))
    assert eventually(lambda: (running.folder / "given-up.started").exists(), 30)
    begun.cancel()
    assert running.localize(query("next-in-line", timeout_s=30)).answer.status == "localized"


@pytest.mark.parametrize("map_id", ["map_lost", "map_crash_once"])
def test_a_lost_index_is_built_once_for_all_who_wait(running: PoolInThread, map_id: str) -> None:
    jobs = [query(f"{map_id}-{number}", maps=(map_id,), needs_index=True) for number in range(5)]
    for each in running.begin_localizing(*jobs):
        assert each.result(240).answer.status == "localized"
    # One build that ends its process is begun once more.
    assert len(list(running.folder.glob(f"{map_id}-*.rebuilt"))) == (2 if map_id == "map_crash_once" else 1)


def test_a_map_that_cannot_be_built_again_is_left_out_where_others_are_searched(running: PoolInThread) -> None:
    maps = ("map_broken_a", "map_whole", "map_broken_b")
    answer = running.localize(query("several", maps=maps, needs_index=True)).answer
    assert answer.status == "localized"
    assert answer.warnings == [f"{name} was left out: its scan is damaged" for name in maps if "broken" in name]
    with pytest.raises(StoredFileDamagedError, match="its scan is damaged"):
        running.localize(query("alone", maps=maps[:1], needs_index=True))


def test_queries_are_answered_while_a_map_registers_and_its_process_ends(running: PoolInThread) -> None:
    registering = running.begin(running.pool.register(registration("map_new", until="may-end")))
    assert eventually(lambda: any(running.folder.glob("map_new.registering-*")), 60)
    running.localize(query("beside"))
    assert not registering.done()
    (running.folder / "may-end").touch()
    stats = registering.result(240).stats
    assert stats["nice"] >= 10
    assert eventually(lambda: not is_running(stats["pid"]), 30)


def test_a_registration_that_kills_its_process_ends_in_an_error(running: PoolInThread) -> None:
    with pytest.raises(NoWorkerError, match="memory may be too small"):
        running.run(running.pool.register(registration("map_crash", crash=True)))


def test_a_registration_past_its_time_is_ended_with_its_process(running: PoolInThread) -> None:
    job = registration("map_slow", time_limit_s=2.0, until="never")
    with pytest.raises(RegistrationLimitError, match="within 2 s"):
        running.run(running.pool.register(job))
    assert eventually(lambda: not process_of_registration(running, "map_slow"), 30)


def test_a_cancelled_registration_ends_its_process_and_the_next_one_begins(running: PoolInThread) -> None:
    registering = running.begin(running.pool.register(registration("map_cancelled", until="never")))
    assert eventually(lambda: process_of_registration(running, "map_cancelled"), 60)
    registering.cancel()
    assert eventually(lambda: not process_of_registration(running, "map_cancelled"), 30)
    assert running.run(running.pool.register(registration("map_next"))).stats["nice"] >= 10


def process_of_registration(running: PoolInThread, map_id: str) -> bool:
    """Tell whether a process works on the registration of a map."""
    return any(is_running(int(path.name.rpartition("-")[2])) for path in running.folder.glob(f"{map_id}.registering-*"))


def test_a_draining_pool_refuses_what_comes_and_ends_its_processes(running: PoolInThread) -> None:
    (under_way,) = running.begin_localizing(query("last", until="last-go"))
    assert eventually((running.folder / "last.started").exists, 30)
    running.pool.begin_drain()
    with pytest.raises(NoWorkerError, match="shutting down"):
        running.localize(query("too-late"))
    (running.folder / "last-go").touch()
    running.run(running.pool.stop(drain_s=60))
    assert under_way.result(1).answer.status == "localized"
    # Those of the cluster are no children of this process; with a fork server its children end.
    assert not [each for each in psutil.Process().children() if "panoloc.service" in command_of(each.pid)]
