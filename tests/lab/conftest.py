"""Runs commands against the fake service, and cases of the same scene on one scene."""

from collections.abc import Iterator
from functools import lru_cache

import pytest

from panoloc.lab.rooms import cases
from tests.service.cli.commands import fake, panoloc, panorama, scan

__all__ = ["fake", "panoloc", "panorama", "scan"]


@pytest.fixture(scope="session", autouse=True)
def _cases_share_scenes() -> Iterator[None]:
    """Build a scene of cases once: to compute its light takes longer than all else, and nobody changes it."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("build_scene", "change_scene"):
            patch.setattr(cases, name, lru_cache(16)(getattr(cases, name)))
        yield
