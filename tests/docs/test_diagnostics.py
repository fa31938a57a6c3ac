"""The page on formats explains every diagnostic that a map can bear."""

import re

from tests.docs.documentation import ROOT

# Codes stand first in `Diagnostic(…)`, in the readers also in `note(…)`.
_MADE = re.compile(r"""(?:\bDiagnostic|\bnote)\(\s*"([a-z_0-9]+)",""")


def test_every_code_of_the_sources_is_explained_and_no_other() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "core").rglob("*.py")]
    made = {code for source in sources for code in _MADE.findall(source)}
    rows = re.findall(r"^\| (`[^|]+`) \|", (ROOT / "docs" / "formats.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert made == {code for row in rows for code in re.findall(r"`([a-z_0-9]+)`", row)}
