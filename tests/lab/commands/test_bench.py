"""`panoloc bench`: its options, its files, and the parts that talk to a service, against the fake one."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import httpx
import pytest
import torch

from panoloc.lab.background_service import BackgroundService, own_service
from panoloc.lab.benchmark.core_parts import CORE_PARTS
from panoloc.lab.benchmark.service_parts import SERVICE_PARTS, ServiceBenchmark
from panoloc.lab.benchmark.sizes import QUICK
from panoloc.lab.commands.bench import Part
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import Session
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, answer_with, problem

URL = "http://127.0.0.1:8000"


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.slow
def test_figures_and_tables_of_chosen_parts_are_printed_and_written(panoloc: Panoloc, tmp_path: Path) -> None:
    arguments = ("bench", "--quick", "--part", "stages", "--part", "index", "--threads", "1", "--out", tmp_path)
    done = panoloc(*arguments, "--device", "cpu")
    assert done.code == ExitCode.OK, done.err
    written = json.loads((tmp_path / "bench.json").read_text())
    assert list(written["parts"]) == ["stages", "index"]
    assert (written["quick"], written["machine"]["torch_threads"]) == (True, 1)
    for text in (done.out, (tmp_path / "bench.txt").read_text()):
        assert "Stages of a query" in text
        assert "Map index" in text
        assert "quick sizes" in text
    assert "index: measured in" in done.err


@pytest.mark.slow
def test_in_json_mode_one_document_with_the_sizes_that_were_asked_for_is_printed(
    panoloc: Panoloc, tmp_path: Path
) -> None:
    (document,) = panoloc(
        "bench", "--quick", "--part", "index", "--points", "3000", "--starts", "6", "--repeats", "3", "--json",
        "--out", tmp_path,
    ).documents  # fmt: skip
    assert document == json.loads((tmp_path / "bench.json").read_text())
    assert document["parts"]["index"]["points"] == 3_000
    assert document["parts"]["index"]["encode"]["num"] == 3


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


def test_the_papers_method_can_be_left_out(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    done = panoloc("bench", "--quick", "--part", "query", "--url", URL, "--no-paper", "--json", "--out", tmp_path)
    assert done.documents[0]["parts"]["query"]["paper"] is None
    assert b"paper" not in fake.parts["options"][0]


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


def test_no_service_at_the_url_is_said(panoloc: Panoloc, fake: FakeService, tmp_path: Path) -> None:
    fake.down = True
    done = panoloc("bench", "--quick", "--part", "query", "--url", URL, "--out", tmp_path)
    assert done.code == ExitCode.UNREACHABLE


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--part", "speed"), ExitCode.USAGE, "speed"),
        (("--scan-format", "xyz"), ExitCode.USAGE, "xyz"),
        (("--device", "tpu"), ExitCode.USAGE, "tpu"),
        (("--points", "3"), ExitCode.USAGE, "--points"),
        (("--starts", "5000"), ExitCode.USAGE, "--starts"),
        (("--clients", "0"), ExitCode.USAGE, "--clients"),
        (("--repeats", "0"), ExitCode.USAGE, "--repeats"),
        (("--part", "memory", "--url", URL), ExitCode.ERROR, "memory: expected a service that this command starts"),
        (("--url", "nowhere", "--part", "query"), ExitCode.ERROR, "Expected a URL such as"),
    ],
)
def test_wrong_options_are_one_message(
    panoloc: Panoloc, tmp_path: Path, arguments: tuple[str, ...], code: ExitCode, said: str
) -> None:
    done = panoloc("bench", "--quick", *arguments, "--out", tmp_path / "out")
    assert done.code == code
    assert said in done.err
    assert "Traceback" not in done.err


def test_a_gpu_that_is_not_there_is_said_before_anything_runs(
    panoloc: Panoloc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    done = panoloc("bench", "--quick", "--device", "cuda", "--out", tmp_path / "out")
    assert done.code == ExitCode.ERROR
    assert "expected a GPU that PyTorch can use, found none" in done.err
    assert not (tmp_path / "out").exists()


def test_every_part_has_a_name_on_the_command_line() -> None:
    assert [part.value for part in Part] == [*CORE_PARTS, *SERVICE_PARTS]


def test_memory_is_measured_before_while_and_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[tuple[int, int]] = []
    monkeypatch.setattr("panoloc.lab.benchmark.service_parts.time.sleep", lambda seconds: None)
    monkeypatch.setattr(ServiceBenchmark, "send", lambda self, clients, number: sent.append((clients, number)))
    run = ServiceBenchmark(QUICK, Session(), URL, os.getpid(), {}, (), paper=False, say=lambda text: None)
    found = SERVICE_PARTS["memory"](run)
    assert sent == [(1, 0), (1, QUICK.queries)]  # the warm-up sends each panorama once
    assert found["peak_bytes"] >= max(found["idle_bytes"], found["after_bytes"]) > 0
    assert sum(found["idle_by_process"].values()) == found["idle_bytes"]


def test_a_service_that_never_becomes_ready_is_stopped_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[Mapping[str, str]] = []
    started: list[subprocess.Popen[bytes]] = []

    def start(url: str, log: Path, settings: Mapping[str, str], survives: bool) -> BackgroundService:
        assert not survives
        told.append(settings)
        started.append(subprocess.Popen(["sleep", "60"]))
        return BackgroundService(started[0], log)

    def never_ready(client: object, service: object, say: Callable[[str], None]) -> None:
        raise TimeoutError("not ready")

    monkeypatch.setattr("panoloc.lab.background_service.start_in_background", start)
    monkeypatch.setattr("panoloc.lab.background_service.wait_until_ready", never_ready)
    with pytest.raises(TimeoutError), own_service({"PANOLOC_MAX_TIMEOUT_S": "900"}, tmp_path / "service.log"):
        pass
    assert started[0].poll() is not None
    assert not Path(told[0]["PANOLOC_DATA_DIR"]).parent.exists()
    assert told[0]["PANOLOC_MAX_TIMEOUT_S"] == "900"
