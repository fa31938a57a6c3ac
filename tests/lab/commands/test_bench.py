"""`panoloc bench`: its options, its files, and the parts that talk to a service, against the fake one."""

import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import torch

from panoloc.core.kernels.library import num_threads, use_threads
from panoloc.lab.benchmark.core_parts import CORE_PARTS
from panoloc.lab.benchmark.service_parts import SERVICE_PARTS
from panoloc.lab.commands.bench import Part
from panoloc.service.cli.exit_codes import ExitCode
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, answer_with, problem

URL = "http://127.0.0.1:8000"


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    before = num_threads()
    yield
    use_threads(before)


@pytest.mark.slow
def test_figures_and_tables_of_chosen_parts_are_printed_and_written(panoloc: Panoloc, tmp_path: Path) -> None:
    parts = ("--part", "stages", "--part", "index", "--points", "3000", "--starts", "6", "--repeats", "3")
    done = panoloc("bench", "--quick", *parts, "--threads", "1", "--device", "cpu", "--out", tmp_path)
    assert done.code == ExitCode.OK, done.err
    written = json.loads((tmp_path / "bench.json").read_text())
    assert list(written["parts"]) == ["stages", "index"]
    index = written["parts"]["index"]
    assert (index["points"], index["encode"]["num"]) == (3_000, 3)
    assert (written["quick"], written["machine"]["threads"]) == (True, 1)
    for text in (done.out, (tmp_path / "bench.txt").read_text()):
        assert "Stages of a query" in text
        assert "Map index" in text
        assert "quick sizes" in text
    assert "index: measured in" in done.err


def test_queries_to_a_service_that_is_given_are_counted_and_the_map_is_deleted(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path
) -> None:
    done = panoloc(
        "bench", "--quick", "--part", "query", "--url", URL, "--clients", "1", "--clients", "3",
        "--queries", "5", "--json", "--out", tmp_path,
    )  # fmt: skip
    assert done.code == ExitCode.OK, done.err
    query = done.documents[0]["parts"]["query"]
    assert [(row["clients"], row["queries"], row["failed"], row["localized"]) for row in query["rows"]] == [
        (1, 5, 0, 5),
        (3, 5, 0, 5),
    ]
    for row in [*query["rows"], query["paper"]]:
        latency = row["latency"]
        assert 0 < latency["min_ms"] <= latency["median_ms"] <= latency["p95_ms"] <= latency["max_ms"]
        assert row["throughput_per_s"] > 0
        assert row["service_stages_ms"]["total"] == pytest.approx(510)
        assert row["max_position_error_m"] > 0
    fast, paper = query["rows"][0]["latency"]["median_ms"], query["paper"]["latency"]["median_ms"]
    assert query["paper"]["ratio"] == pytest.approx(paper / fast)
    assert query["map"]["num_starts"] == 412
    # Warm-up, both numbers of clients, and one of the paper's method.
    assert fake.requests.count(("POST", "/localize")) == 2 + 5 + 5 + 1
    assert fake.requests[-1] == ("DELETE", "/maps/map_1")


@pytest.mark.slow
def test_cameras_take_turns_in_rooms_of_their_own(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    done = panoloc("bench", "--quick", "--part", "cameras", "--url", URL, "--json", "--out", tmp_path)
    assert done.code == ExitCode.OK, done.err
    rows = done.documents[0]["parts"]["cameras"]["rows"]
    assert [(row["camera"], row["images"], row["queries"]) for row in rows] == [
        ("panorama", 1, 2),
        ("photo", 1, 2),
        ("frames6", 6, 2),
    ]
    # The fake's pose is a fixed one, which is nobody's.
    assert [(row["localized"], row["right"]) for row in rows] == [(2, 0)] * 3
    assert rows[0]["ratio"] == 1
    options = json.loads(fake.parts["options"][0])
    assert (len(options["cameras"]), options["session"]) == (6, {"up": "known"})
    # The painted room of the other parts, and the furnished one.
    assert fake.requests.count(("DELETE", "/maps/map_1")) == 2


def test_a_query_that_fails_is_counted_beside_those_that_do_not(
    panoloc: Panoloc, fake: FakeService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = [httpx.Response(200, json=answer_with("localized")) for _ in range(2 + 3)]
    busy = problem(429, "Too many queries", "the queue is full; try again later.")
    monkeypatch.setattr(fake, "_localize", lambda request: answers.pop() if answers else busy)
    done = panoloc(
        "bench", "--quick", "--part", "query", "--url", URL, "--clients", "1", "--queries", "4", "--out", tmp_path
    )
    assert done.code == ExitCode.OK, done.err
    query = json.loads((tmp_path / "bench.json").read_text())["parts"]["query"]
    assert (query["rows"][0]["failed"], query["rows"][0]["last_error"]) == (1, "the queue is full; try again later.")
    # The paper's query failed too; the other figures are kept.
    assert query["paper"] == {"error": "the queue is full; try again later.", "ratio": None}
    assert "method paper: the queue is full" in done.err


def test_a_service_that_refuses_everything_is_an_error(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    fake.refuse_file = "JFIF"
    done = panoloc("bench", "--quick", "--part", "query", "--url", URL, "--out", tmp_path)
    assert done.code == ExitCode.ERROR
    assert "Not a panorama" in done.err
    assert fake.requests[-1] == ("DELETE", "/maps/map_1")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--part", "speed"), ExitCode.USAGE, "speed"),
        (("--part", "memory", "--url", URL), ExitCode.ERROR, "memory: expected a service that this command starts"),
        (("--url", "nowhere", "--part", "query"), ExitCode.ERROR, "Expected a URL such as"),
        (("--device", "cuda"), ExitCode.ERROR, "expected a GPU that PyTorch can use, found none"),
    ],
)
def test_wrong_options_are_one_message(
    panoloc: Panoloc,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    code: ExitCode,
    said: str,
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    done = panoloc("bench", "--quick", *arguments, "--out", tmp_path / "out")
    assert done.code == code
    assert said in done.err
    assert "Traceback" not in done.err


def test_every_part_has_a_name_on_the_command_line() -> None:
    assert list(Part) == [*CORE_PARTS, *SERVICE_PARTS]
