"""Scans are read in this process, but where a test is about the box that strangers' scans are read in."""

import pytest


@pytest.fixture(autouse=True)
def _read_here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read here, where a warning is an error and lines are counted; to start a process for each file takes longer than the reading.

    A damaged LAZ aborts the process that reads it.
    """
    if not {"sandbox", "test_las_reading.py"} & {*request.path.parts}:
        monkeypatch.setattr("panoloc.core.scan.reading.SANDBOXED", frozenset())
