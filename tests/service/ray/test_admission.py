import pytest

from service.errors import QueueFullError
from service.ray.admission import Admission


def test_as_many_are_admitted_as_run_and_wait() -> None:
    admission = Admission(queue_limit=2)
    with admission.admit(), admission.admit(), admission.admit():
        assert admission.queue_depth == 2
        with pytest.raises(QueueFullError, match="2 requests are waiting"), admission.admit():
            pass
    assert admission.num_admitted == 0


def test_without_a_queue_one_request_per_worker_still_runs() -> None:
    admission = Admission(queue_limit=0)
    with admission.admit(), pytest.raises(QueueFullError), admission.admit():
        pass


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
