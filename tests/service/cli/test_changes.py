"""`panoloc changes` against a fake service."""

from pathlib import Path

import httpx
import pytest

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.http.schemas.examples import CHANGES_EXAMPLE
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService


def test_objects_are_listed_with_place_size_and_certainty(panoloc: Panoloc, fake: FakeService) -> None:
    fake.at_maps["map_1/changes"] = httpx.Response(200, json=CHANGES_EXAMPLE)
    out = panoloc("changes", "map_1").out
    assert "moved" in out
    assert "2.03, 0.98, 0.44 from 0.61, 1.20, 0.44" in out
    assert "91%" in out
    (document,) = panoloc("changes", "map_1", "--json").documents
    assert document["objects"] == CHANGES_EXAMPLE["objects"]


def test_a_report_is_written_under_the_ending_of_its_format_alone(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    fake.on_request = lambda request: httpx.Response(200, content=b"a report")
    former = tmp_path / "report.pdf"
    former.write_bytes(b"of another format")
    for options in (
        ("--format", "html", "--out", former),
        ("--out", former),
        ("--format", "pdf", "--out", tmp_path / "pdf"),
    ):
        assert panoloc("changes", "map_1", *options).code == ExitCode.USAGE
    assert (former.read_bytes(), fake.requests) == (b"of another format", [])
    for format, name in (("pdf", "report.PDF"), ("bcf", "report.bcf"), ("bcf", "report.bcfzip")):
        assert panoloc("changes", "map_1", "--format", format, "--out", tmp_path / name).code == 0
        assert (tmp_path / name).read_bytes() == b"a report"


def test_without_photos_it_says_what_to_do(panoloc: Panoloc, fake: FakeService) -> None:
    fake.at_maps["map_1/changes"] = httpx.Response(200, json={**CHANGES_EXAMPLE, "objects": [], "num_photos": 0})
    assert "panoloc place" in panoloc("changes", "map_1").err
    assert "this period" in panoloc("changes", "map_1", "--since", "2026-11-21").err


def test_a_report_of_a_period_becomes_a_file(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    fake.at_maps["map_1/changes/report"] = httpx.Response(200, content=b"%PDF-")
    done = panoloc("changes", "map_1", "--format", "pdf", "--since", "2026-11-21T12:00:00Z")
    assert done.code == 0
    assert (tmp_path / "map_1-changes.pdf").read_bytes() == b"%PDF-"
    assert "since=2026-11-21T12%3A00%3A00Z&format=pdf" in fake.requests[-1][1]
