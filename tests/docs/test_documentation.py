"""What the documentation says is there is there: links, commands, options, exit codes, files, settings and diagnostics."""

import os
import re
from pathlib import Path

import pytest
import typer

from docs.settings_table import PAGE, settings_table, with_current_table
from panoloc.service.cli.entry import app
from panoloc.service.cli.exit_codes import ExitCode
from tests.docs.documentation import PAGES, ROOT, anchors, relative_links, shell_commands

COMMANDS = [(page, words) for page in PAGES for words in shell_commands(page)]
CLI = typer.main.get_command(app)
SETTINGS = set(re.findall(r"PANOLOC_[A-Z_]+", settings_table()))
# Read by commands and compose files, not by the service.
OTHERS = {"PANOLOC_URL", "PANOLOC_API_KEY", "PANOLOC_EVAL_THREADS", "PANOLOC_METRICS_KEY"}
# Codes stand first in `Diagnostic(…)`, in the readers also in `note(…)`.
MADE = re.compile(r"""(?:\bDiagnostic|\bnote)\(\s*"([a-z_0-9]+)",""")


def options_of(words: list[str]) -> set[str]:
    """Return the options of the command that `words` name, following subcommands."""
    command, rest = CLI, words[1:]
    found: set[str] = set()
    while True:
        found |= {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
        commands = getattr(command, "commands", {})
        if not rest or rest[0] not in commands:
            assert command is not CLI, f"{' '.join(words)}: no such command"
            return found | {"--help", "-h"}
        command, rest = commands[rest[0]], rest[1:]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    for link in relative_links(page):
        name, _, anchor = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.exists(), f"{page.name} links to {link}"
        assert not anchor or anchor in anchors(target), f"{page.name} links to {link}"


@pytest.mark.parametrize(("page", "words"), COMMANDS, ids=lambda value: value.name if isinstance(value, Path) else None)
def test_every_command_of_the_documentation_exists(page: Path, words: list[str]) -> None:
    name = words[0]
    if name == "panoloc":
        used = {word.partition("=")[0] for word in words if word.startswith("-")}
        assert used <= options_of(words), f"{page.name}: {' '.join(words)}"
    elif name.startswith(("scripts/", ".ci/")):
        assert os.access(ROOT / name, os.X_OK), f"{page.name}: {name}"
    for word in words[1:]:
        if word.startswith(("docker/", "service/", "core/", "lab/", "tests/", "scripts/")):
            assert (ROOT / word).exists(), f"{page.name}: {word}"


def test_the_readme_begins_with_the_two_commands() -> None:
    first, second, *_ = shell_commands(ROOT / "README.md")
    assert (first, second) == (["scripts/demo"], ["scripts/test"])


def test_the_page_on_the_command_line_names_every_command_and_option() -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(--?[a-z][a-z-]*)`", page))
    for name, command in CLI.commands.items():  # type: ignore[attr-defined]
        assert f"## `panoloc {name}" in page
        for parameter in command.params:
            long_names = {option for option in parameter.opts if option.startswith("--")}
            assert long_names <= named, f"panoloc {name}: docs/cli.md does not name {long_names - named}"


def test_the_page_on_the_command_line_names_every_exit_code() -> None:
    page = (ROOT / "docs" / "cli.md").read_text(encoding="utf-8")
    listed = {int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)}
    assert listed == {int(code) for code in ExitCode}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_named_in_the_text_exist(page: Path) -> None:
    named = re.findall(r"`((?:core|lab|service|docker|scripts|tests)/[\w./-]*)`", page.read_text(encoding="utf-8"))
    missing = [name for name in named if not (ROOT / name).exists()]
    assert missing == []


def test_the_page_on_operations_has_the_current_settings() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert page == with_current_table(page), "run scripts/update-docs"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_variable_that_a_page_names_is_a_setting(page: Path) -> None:
    named = set(re.findall(r"\bPANOLOC_[A-Z_]*[A-Z]\b", page.read_text(encoding="utf-8")))
    assert named - OTHERS <= SETTINGS


def test_every_code_of_the_sources_is_explained_and_no_other() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "core").rglob("*.py")]
    made = {code for source in sources for code in MADE.findall(source)}
    rows = re.findall(r"^\| (`[^|]+`) \|", (ROOT / "docs" / "formats.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert made == {code for row in rows for code in re.findall(r"`([a-z_0-9]+)`", row)}
