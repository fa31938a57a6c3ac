"""The pool with real Ray processes and a scripted worker. One cluster for all tests of this module."""

import os
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from core.errors import DeadlineExceededError, PanoramaShapeError
from service.errors import QueueFullError, ServiceError
from service.host.process_tree import descendants, process_name
from service.jobs import LocalizeOutcome
from tests.integration.pool_in_thread import PoolInThread, query, registration
from tests.integration.running_service import eventually

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def running() -> Iterator[PoolInThread]:
    with tempfile.TemporaryDirectory(prefix="pl-") as folder:
        running = PoolInThread(Path(folder))
        try:
            running.wait_until_ready()
            yield running
        finally:
            running.stop()
        assert [process_name(pid) for pid in descendants(os.getpid()) if "ray" in process_name(pid)] == []


def test_a_query_is_answered_by_another_process(running: PoolInThread) -> None:
    figures = running.localize(query("first")).answer.search
    assert figures["request_id"] == "first"
    assert figures["pid"] in descendants(os.getpid())
    assert running.pool.state().resident_bytes == 1234


def test_a_worker_killed_with_eight_queries_under_way_costs_no_answer(running: PoolInThread) -> None:
    pid = running.localize(query("before-kill")).answer.search["pid"]
    jobs = [query(f"kill-{number}", seconds=0.2) for number in range(8)]
    begun = [running.begin(running.pool.localize(each)) for each in jobs]
    time.sleep(0.3)
    os.kill(pid, signal.SIGKILL)
    found = [each.result(240).answer.search for each in begun]
    assert [figures["request_id"] for figures in found] == [each.request_id for each in jobs]
    assert any(figures["pid"] != pid for figures in found)


def test_a_query_that_kills_its_worker_is_tried_again(running: PoolInThread) -> None:
    assert running.localize(query("crash", crash_once=True)).answer.search["request_id"] == "crash"


def test_what_the_worker_raises_on_purpose_is_raised_here_as_well(running: PoolInThread) -> None:
    with pytest.raises(PanoramaShapeError, match="as the script says"):
        running.localize(query("bad", fail="PanoramaShapeError"))


def test_a_full_queue_turns_the_next_query_away(running: PoolInThread) -> None:
    outcomes = running.localize_all([query(f"full-{number}", seconds=0.1) for number in range(15)])
    refused = [outcome for outcome in outcomes if isinstance(outcome, QueueFullError)]
    assert len(refused) == 4
    assert all(error.retry_after_s >= 1 for error in refused)
    assert sum(isinstance(outcome, LocalizeOutcome) for outcome in outcomes) == 11


def test_a_query_past_its_deadline_fails_and_what_had_not_begun_is_dropped(running: PoolInThread) -> None:
    slow = [query(f"slow-{number}", seconds=0.7) for number in range(2)]
    for _ in range(30):  # on a busy machine earlier ones took so long that the late one would be refused at the door
        running.admission.note_duration(0.01, slow[0].kind)
    outcomes = running.localize_all([*slow, query("late", timeout_s=0.4)])
    assert [type(outcome) for outcome in outcomes] == [LocalizeOutcome, LocalizeOutcome, DeadlineExceededError]
    time.sleep(0.5)
    assert not (running.folder / "late.started").exists()


def test_a_lost_index_is_built_once_for_all_who_wait(running: PoolInThread) -> None:
    outcomes = running.localize_all(
        [query(f"lost-{number}", maps=("map_lost",), needs_index=True) for number in range(5)]
    )
    assert all(isinstance(outcome, LocalizeOutcome) for outcome in outcomes), outcomes
    assert len(list(running.folder.glob("map_lost-*.rebuilt"))) == 1


def test_queries_are_answered_while_a_map_registers_and_its_process_ends(running: PoolInThread) -> None:
    may_end = running.folder / "may-end"
    registering = running.begin(running.pool.register(registration("map_new", until=str(may_end))))
    time.sleep(1)
    running.localize(query("beside"))
    assert not registering.done()
    may_end.touch()
    stats = registering.result(240).stats
    assert stats["nice"] >= 10
    assert eventually(lambda: stats["pid"] not in descendants(os.getpid()), 90)


def test_a_registration_that_keeps_killing_its_process_ends_in_an_error(running: PoolInThread) -> None:
    with pytest.raises(ServiceError, match="too little memory"):
        running.run(running.pool.register(registration("map_crash", crash=True)))
