"""Set-up shared by the tests that start real processes."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def pytest_configure(config: pytest.Config) -> None:
    # Ray Serve's own models, not ours.
    config.addinivalue_line("filterwarnings", "ignore::DeprecationWarning:ray")


# Test modules import their companions, and Ray's workers the scripted worker, as `tests.integration.…`.
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))
