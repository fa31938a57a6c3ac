"""DDS of the tests of this folder: on the loopback, in a domain of its own."""

import pytest

from tests.ros2.running_node import environment


@pytest.fixture
def dds_network(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set the variables that DDS reads in this process."""
    for name, value in environment().items():
        monkeypatch.setenv(name, value)
