import pytest

import panoloc.core.errors
import panoloc.service.errors
from panoloc.core.errors import PanoramaShapeError
from panoloc.service.errors import EXPECTED_ERRORS, WorkerError
from panoloc.service.worker.plan import WorkerFailure, error_of, guarded


def raise_(error: Exception) -> None:
    raise error


def test_an_exception_becomes_a_value_with_its_name_and_message() -> None:
    outcome, failure = guarded(lambda: raise_(PanoramaShapeError("expected 2:1, got 3:2")))
    assert outcome is None
    assert failure is not None
    assert (failure.kind, failure.message) == ("PanoramaShapeError", "expected 2:1, got 3:2")
    assert failure.traceback == ""


def test_an_unexpected_exception_has_a_traceback() -> None:
    _, failure = guarded(lambda: raise_(ZeroDivisionError("division by zero")))
    assert failure is not None
    assert "in raise_" in failure.traceback


def test_keyboard_interrupt_passes_through() -> None:
    with pytest.raises(KeyboardInterrupt):
        guarded(lambda: (_ for _ in ()).throw(KeyboardInterrupt))


RAISED = [
    kind
    for module in (panoloc.core.errors, panoloc.service.errors)
    for kind in vars(module).values()
    if isinstance(kind, type) and issubclass(kind, EXPECTED_ERRORS) and kind is not WorkerError
]


@pytest.mark.parametrize("kind", RAISED, ids=lambda kind: kind.__name__)
def test_an_expected_exception_comes_back_as_itself(kind: type[Exception]) -> None:
    _, failure = guarded(lambda: raise_(kind("expected this, got that")))
    assert failure is not None
    error = error_of(failure)
    assert type(error) is kind
    assert (str(error), failure.traceback) == ("expected this, got that", "")


@pytest.mark.parametrize("kind", ["ZeroDivisionError", "Any", "WorkerError", "EXPECTED_ERRORS"])
def test_an_unexpected_exception_becomes_a_worker_error_with_its_name(kind: str) -> None:
    error = error_of(WorkerFailure(kind, "message"))
    assert isinstance(error, WorkerError)
    assert (error.kind, str(error)) == (kind, "message")
