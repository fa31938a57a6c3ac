"""The settings that the documentation names are those of the code."""

import re
from pathlib import Path

import pytest

from docs.settings_table import PAGE, settings_table, with_current_table
from tests.docs.documentation import PAGES

SETTINGS = set(re.findall(r"PANOLOC_[A-Z_]+", settings_table()))
# Read by commands and compose files, not by the service.
OTHERS = {"PANOLOC_URL", "PANOLOC_API_KEY", "PANOLOC_EVAL_THREADS", "PANOLOC_METRICS_KEY"}


def test_the_page_on_operations_has_the_current_settings() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == with_current_table(page), "run scripts/update-docs"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_variable_that_a_page_names_is_a_setting(page: Path) -> None:
    named = set(re.findall(r"\bPANOLOC_[A-Z_]*[A-Z]\b", page.read_text(encoding="utf-8")))
    assert named - OTHERS <= SETTINGS
