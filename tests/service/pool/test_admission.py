from contextlib import ExitStack

import pytest

from panoloc.service.errors import QueueFullError
from panoloc.service.pool.admission import Admission


def test_a_failed_request_gives_its_place_back() -> None:
    admission = Admission(queue_limit=0)
    with pytest.raises(ZeroDivisionError), admission.admit():
        raise ZeroDivisionError
    with admission.admit():
        assert admission.num_admitted == 1


def test_the_wait_grows_with_the_queue_and_shrinks_with_workers() -> None:
    admission = Admission(queue_limit=100)
    for _ in range(100):
        admission.note_duration(2.0)
    with admission.admit(), admission.admit(), admission.admit(), admission.admit():
        assert admission.retry_after_s == 8
        admission.set_num_workers(4)
        assert admission.retry_after_s == 2


def test_nobody_is_told_to_come_back_at_once_or_never() -> None:
    admission = Admission(queue_limit=1)
    assert admission.retry_after_s == 1
    for _ in range(50):
        admission.note_duration(1e6)
    with admission.admit():
        assert admission.retry_after_s == 60


@pytest.mark.parametrize(("num_workers", "queue_limit"), [(0, 1), (1, 0), (1, 2), (3, 1)])
def test_as_many_are_admitted_as_run_and_wait_and_one_runs_where_there_is_no_worker_yet(
    num_workers: int, queue_limit: int
) -> None:
    admission = Admission(queue_limit)
    admission.set_num_workers(num_workers)
    with ExitStack() as held:
        for number in range(max(1, num_workers) + queue_limit):
            assert admission.num_admitted == number
            held.enter_context(admission.admit())
        assert admission.queue_depth == queue_limit
        with pytest.raises(QueueFullError, match=f"{queue_limit} requests are waiting") as refused, admission.admit():
            pass
        assert refused.value.retry_after_s == admission.retry_after_s
    assert admission.num_admitted == 0


def test_before_anything_was_measured_a_request_is_taken_to_last_a_second() -> None:
    admission = Admission(queue_limit=9)
    assert admission.queue_depth == 0
    with admission.admit(), admission.admit(), admission.admit():
        assert admission.retry_after_s == 3


def test_what_would_not_be_done_in_time_is_refused_at_once_and_told_when_to_come_back() -> None:
    admission = Admission(queue_limit=64)
    for _ in range(100):
        admission.note_duration(2.0, "fast")
    with ExitStack() as held:
        for _ in range(24):
            held.enter_context(admission.admit("fast", remaining_s=60))
        # 24 of 2 s, each a quarter longer than the mean at worst, take the whole minute.
        with pytest.raises(QueueFullError, match="allow more time") as refused, admission.admit("fast", remaining_s=60):
            pass
        assert 1 <= refused.value.retry_after_s <= 5
        held.enter_context(admission.admit("fast", remaining_s=600))


def test_kinds_of_requests_are_measured_apart_and_wait_for_each_other() -> None:
    admission = Admission(queue_limit=64)
    for _ in range(100):
        admission.note_duration(1.0, "fast")
        admission.note_duration(100.0, "paper")
    with admission.admit("fast", 60):
        with admission.admit("fast", 60), pytest.raises(QueueFullError), admission.admit("paper", 60):
            pass
        with admission.admit("paper", 600), pytest.raises(QueueFullError) as refused, admission.admit("fast", 60):
            pass
        assert refused.value.retry_after_s == 60


def test_a_request_that_nobody_is_before_is_tried_however_long_the_last_ones_took() -> None:
    admission = Admission(queue_limit=64)
    for _ in range(100):
        admission.note_duration(1000.0)
    with admission.admit(remaining_s=1):
        assert admission.num_admitted == 1


def test_the_newest_duration_counts_a_fifth() -> None:
    admission = Admission(queue_limit=9)
    admission.note_duration(11.0)
    with admission.admit():
        assert admission.retry_after_s == 3
    admission.note_duration(53.0)
    with admission.admit():
        assert admission.retry_after_s == 13


def test_a_full_queue_refuses_what_nothing_is_known_of_yet_and_one_with_a_place_does_not() -> None:
    admission = Admission(queue_limit=1)
    with admission.admit():
        admission.require_place(600)
        with admission.admit():
            with pytest.raises(QueueFullError, match="1 requests are waiting") as refused:
                admission.require_place(600)
            assert refused.value.limit == "queue"
        assert admission.num_admitted == 1  # to ask takes no place


def test_work_that_outlasts_the_longest_time_refuses_whatever_it_is() -> None:
    admission = Admission(queue_limit=64)
    admission.require_place(0.0)
    for _ in range(100):
        admission.note_duration(100.0)
    with admission.admit(), admission.admit(), admission.admit():
        admission.require_place(600)
        with admission.admit(), admission.admit():
            with pytest.raises(QueueFullError) as refused:
                admission.require_place(600)
            assert refused.value.limit == "deadline"
