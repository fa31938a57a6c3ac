"""`panoloc bench`: its options, its files, and the parts that talk to a service, against the fake one."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import torch

from lab.background_service import BackgroundService
from lab.benchmark.method.parts import CORE_PARTS
from lab.benchmark.request import BenchRequest
from lab.benchmark.service import measured_service
from lab.benchmark.service.memory import by_name, measure_memory
from lab.benchmark.service.parts import SERVICE_PARTS
from lab.commands.bench import Part
from service.cli.exit_codes import ExitCode
from tests.service.cli.commands import Panoloc
from tests.service.cli.fake_service import FakeService, answer_with, problem

URL = "http://127.0.0.1:8000"


@pytest.fixture(autouse=True)
def same_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def request_of(out: Path, **changed: Any) -> BenchRequest:
    """Return a quick request with some options changed."""
    options: dict[str, Any] = {
        "parts": (), "quick": True, "points": None, "large_points": None, "starts": None, "width": None, "repeats": None,
        "queries": None, "clients": (), "paper": True, "paper_timeout_s": 900.0, "url": None, "device": "cpu",
        "threads": 1, "out": out,
    }  # fmt: skip
    return BenchRequest(**{**options, **changed})


@pytest.mark.slow
def test_figures_and_tables_of_chosen_parts_are_printed_and_written(panoloc: Panoloc, tmp_path: Path) -> None:
    arguments = ("bench", "--quick", "--part", "search", "--part", "index", "--threads", "1", "--out", tmp_path)
    done = panoloc(*arguments, "--device", "cpu")
    assert done.code == ExitCode.OK, done.err
    written = json.loads((tmp_path / "bench.json").read_text())
    assert list(written["parts"]) == ["search", "index"]
    assert {"processor", "cpu_count", "torch_threads", "device", "load_average"} <= set(written["machine"])
    assert {"panoloc", "python", "torch", "numpy"} == set(written["versions"])
    assert (written["quick"], written["machine"]["torch_threads"]) == (True, 1)
    assert written["parts"]["index"]["redis"]["load"]["median_ms"] > 0
    for text in (done.out, (tmp_path / "bench.txt").read_text()):
        assert "Search with score maps" in text
        assert "Map index" in text
        assert "quick sizes" in text
    assert "index: measured in" in done.err


def test_in_json_mode_one_document_is_printed(panoloc: Panoloc, tmp_path: Path) -> None:
    (document,) = panoloc("bench", "--quick", "--part", "search", "--json", "--out", tmp_path).documents
    assert document == json.loads((tmp_path / "bench.json").read_text())


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
    # The room of every benchmark of queries, and one of its own.
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


def test_options_win_over_the_sizes_that_they_name(tmp_path: Path) -> None:
    request = request_of(tmp_path, points=5_000, repeats=3, clients=(7,), queries=9)
    assert (request.sizes.points, request.sizes.repeats) == (5_000, 3)
    assert (request.num_clients, request.num_queries) == ((7,), 9)
    assert request_of(tmp_path, quick=False).num_clients == (1, 4, 16)
    assert request_of(tmp_path, quick=False).sizes.points == 1_000_000


def test_memory_is_measured_before_while_and_after(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.benchmark.service.memory.time.sleep", lambda seconds: None)
    sent: list[int] = []
    found = measure_memory(os.getpid(), request_of(tmp_path, queries=6), lambda text: None, sent.append)
    assert (sent, found.queries) == ([6], 6)
    assert found.peak_bytes >= max(found.idle_bytes, found.after_bytes) > 0
    assert sum(found.idle_by_process.values()) == found.idle_bytes


def test_processes_of_one_name_are_added_up_whatever_they_do_at_the_moment() -> None:
    assert by_name({"1 sh": 2, "2 ray::Replica:a.check_health": 30, "3 ray::Replica:a": 10, "4 sh": 3}) == {
        "ray::Replica:a": 40,
        "sh": 5,
    }


def test_the_services_own_environment_ends_with_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[dict[str, str]] = []
    processes: list[subprocess.Popen[bytes]] = []

    def start(url: str, log: Path, settings: dict[str, str]) -> BackgroundService:
        started.append(settings)
        processes.append(subprocess.Popen(["sleep", "60"]))
        return BackgroundService(processes[0], log)

    def never_ready(client: object, service: object, say: Callable[[str], None]) -> None:
        raise TimeoutError("not ready")

    monkeypatch.setattr(measured_service, "start_in_background", start)
    monkeypatch.setattr(measured_service, "wait_until_ready", never_ready)
    from service.cli.session import Session

    with (
        pytest.raises(TimeoutError),
        measured_service.measured_service(request_of(tmp_path), Session(), lambda text: None),
    ):
        pass
    assert processes[0].poll() is not None
    assert not Path(started[0]["PANOLOC_DATA_DIR"]).parent.exists()
    assert started[0]["CUDA_VISIBLE_DEVICES"] == ""
    assert float(started[0]["PANOLOC_MAX_TIMEOUT_S"]) == 900
