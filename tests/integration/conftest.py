"""Set-up shared by the tests that start real processes."""

import os
import secrets
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # Several services start beside each other, each with half a dozen processes.
    # Ray, where it runs in this process, leaves its processes and files to the garbage collector.
    for item in items:
        if item.nodeid.startswith("tests/integration/"):
            item.add_marker(pytest.mark.filterwarnings("ignore::ResourceWarning"))
            item.add_marker(pytest.mark.timeout(900))


# Test modules import their companions, and Ray's workers the scripted worker, as `tests.integration.…`.
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

# One token for all clusters of this run: Ray reads it once per process, some tests start a cluster and others join one.
os.environ["RAY_AUTH_MODE"] = "token"
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
