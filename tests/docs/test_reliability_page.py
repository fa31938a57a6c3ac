"""The tests that docs/reliability.md names exist."""

import re

from tests.docs.documentation import ROOT


def test_every_loss_names_a_test_that_exists_or_says_that_there_is_none() -> None:
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    table = page.split("| what dies | what is lost | test |")[1].split("\n\n")[0]
    rows = [line for line in table.splitlines() if line.startswith("| ") and "---" not in line]
    named = re.findall(r"`(tests/[\w/]+\.py)`, `(test_\w+)`", table)
    assert len(rows) == 15
    assert all("`test_" in row or "none: " in row for row in rows)
    assert [
        (file, name)
        for file, name in named
        if not re.search(rf"^(async )?def {name}\b", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
    ] == []
