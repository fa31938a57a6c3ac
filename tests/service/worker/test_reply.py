import pytest

from core.errors import CoreError, PanoramaShapeError
from service import errors
from service.worker.reply import WorkerFailure, error_of, guarded


def raise_(error: Exception) -> None:
    raise error


def test_an_exception_becomes_a_value_with_its_name_and_message() -> None:
    outcome, failure = guarded(lambda: raise_(PanoramaShapeError("expected 2:1, got 3:2")))
    assert outcome is None
    assert failure is not None
    assert (failure.kind, failure.message) == ("PanoramaShapeError", "expected 2:1, got 3:2")
    assert failure.traceback == ""


def test_a_fault_that_nobody_raised_on_purpose_tells_its_place() -> None:
    _, failure = guarded(lambda: raise_(ZeroDivisionError("division by zero")))
    assert failure is not None
    assert "in raise_" in failure.traceback


def test_what_ends_the_process_passes_through() -> None:
    with pytest.raises(KeyboardInterrupt):
        guarded(lambda: (_ for _ in ()).throw(KeyboardInterrupt))


def test_errors_of_the_service_come_back_as_themselves() -> None:
    assert isinstance(error_of(WorkerFailure("CacheDownError", "no Redis")), errors.CacheDownError)
    assert isinstance(error_of(WorkerFailure("MapNotFoundError", "gone")), errors.MapNotFoundError)


def test_a_deadline_inside_the_algorithm_is_a_deadline() -> None:
    assert isinstance(error_of(WorkerFailure("DeadlineExceededError", "late")), errors.DeadlineError)


@pytest.mark.parametrize("kind", [*(each.__name__ for each in CoreError.__subclasses__()), "ZeroDivisionError", "Any"])
def test_everything_else_keeps_its_name(kind: str) -> None:
    error = error_of(WorkerFailure(kind, "message"))
    if kind != "DeadlineExceededError":
        assert isinstance(error, errors.WorkerError)
        assert error.kind == kind
