"""The code of docs/python.md does what the page says, against a real service."""

import re
from pathlib import Path
from typing import Any

import pytest

from panoloc import PanolocClient
from tests.integration.running_service import ROOT, RunningService
from tests.integration.small_room import small_room

pytestmark = pytest.mark.integration


def test_the_page_leads_from_a_scan_to_a_pose_and_to_the_next_one(
    service: RunningService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(encoding="utf-8"), re.S)
    (tmp_path / "office.ply").write_bytes(small_room().scan)
    (tmp_path / "photo.jpg").write_bytes(small_room().panorama)
    monkeypatch.chdir(tmp_path)
    url, names = str(service.http.base_url), dict[str, Any]()
    for block in blocks:
        exec(block.replace("http://127.0.0.1:8000", url), names)
    assert small_room().error_of(names["answer"].model_dump()).within(0.05, 5)
    assert str(names["answer"].confidence) in capsys.readouterr().out
    with PanolocClient(url) as client:
        again = names["localize_again"](client, Path("photo.jpg"), names["answer"])
    assert (again.status, again.search["num_starts"]) == ("localized", 0)
