"""Runs commands against the fake service, cases of the same scene on one scene, and nothing under the eyes of coverage."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import pytest

from panoloc.lab.rooms import cases
from tests.service.cli.commands import fake, panoloc, panorama, scan

__all__ = ["fake", "panoloc", "panorama", "scan"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    # What they run of the service and the core is covered by its own tests.
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent):
            item.add_marker("no_cover")


@pytest.fixture(scope="session", autouse=True)
def _cases_share_scenes() -> Iterator[None]:
    """Build a scene of cases once: to compute its light takes longer than all else, and nobody changes it."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("build_scene", "change_scene"):
            patch.setattr(cases, name, lru_cache(16)(getattr(cases, name)))
        yield
