"""The settings table of the README is that of the code."""

import re
from pathlib import Path

import pytest

from docs.settings_table import settings_table, with_current_table
from service.settings import Settings
from tests.docs.documentation import ROOT


def test_the_readme_has_the_current_settings() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert readme == with_current_table(readme), "run scripts/update-docs"


def test_every_setting_has_a_row_with_a_meaning() -> None:
    rows = re.findall(r"^\| (`PANOLOC_.+?`) \| (.+?) \| (.+) \|$", settings_table(), re.MULTILINE)
    assert len(rows) == len(Settings.model_fields)
    assert all(meaning.strip() for _, _, meaning in rows)


@pytest.mark.parametrize(("variable", "value"), [("PANOLOC_PORT", "8123"), ("PANOLOC_LOG_LEVEL", "debug")])
def test_a_variable_of_the_table_sets_what_it_names(monkeypatch: pytest.MonkeyPatch, variable: str, value: str) -> None:
    assert f"| `{variable}` |" in settings_table()
    monkeypatch.setenv(variable, value)
    assert str(getattr(Settings(), variable.removeprefix("PANOLOC_").lower())) == value


def test_every_variable_of_the_container_files_is_a_setting() -> None:
    known = set(re.findall(r"PANOLOC_[A-Z_]+", settings_table()))
    for file in (ROOT / "Dockerfile", *sorted(Path(ROOT / "docker").glob("*.yaml"))):
        used = set(re.findall(r"\b(PANOLOC_[A-Z_]+)[:=]", file.read_text(encoding="utf-8"))) - {
            "PANOLOC_PUBLISHED_PORT"
        }
        assert used <= known, file.name
