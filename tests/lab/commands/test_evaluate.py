"""`panoloc evaluate` and `panoloc evaluate fit`, run as a person runs them."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from panoloc.core.decide.confidence import FEATURES
from panoloc.core.geometry.pose import Pose
from panoloc.core.kernels.library import num_threads, use_threads
from panoloc.lab.commands import evaluation_run
from panoloc.lab.evaluation.known_cases import ScanCases
from panoloc.lab.evaluation.runner import RunOptions
from panoloc.lab.rooms import PosedPanorama, write_case_folder
from panoloc.service.cli.exit_codes import ExitCode
from tests.core.painted_box import PaintedBox, rotation_of
from tests.lab.evaluation.made_rows import made_row, searched
from tests.service.cli.commands import Panoloc

METHOD = "quick=fast:search.rotations=2304,search.num_candidates=8,refinement.fine_rows=64"


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("PANOLOC_EVAL_THREADS", "1")
    before = num_threads()
    yield
    use_threads(before)


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cases")
    box = PaintedBox(seed=3, size_m=(3.2, 3.0, 2.4))
    pose = Pose(rotation_of(20.0, 3.0), np.array([1.4, 1.8, 1.3]))
    posed = PosedPanorama("q", box.panorama(pose, 128), pose, tags=("day",))
    write_case_folder(folder / "box", "box", box.scan(6_000), [posed])
    return folder


@pytest.mark.slow
def test_tables_json_and_rows_are_written_and_a_second_run_reuses_the_rows(
    panoloc: Panoloc, cases: Path, tmp_path: Path
) -> None:
    arguments = ("evaluate", "--cases", cases, "--method", METHOD, "--out", tmp_path / "out", "--within", "0.05,5")

    first = panoloc(*arguments)
    assert first.code == ExitCode.OK, first.err
    assert "quick" in first.out
    assert "0.05 m 5°" in first.out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    (summary,) = report["summaries"]
    assert (summary["group"], summary["num_queries"], summary["accuracies"]) == ("box", 1, [1.0])
    assert report["machine"]["threads"] == 1
    assert report["methods"]["quick"]["digest"]
    assert "quick" in (tmp_path / "out" / "report.txt").read_text()
    assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == 1

    second = panoloc(*arguments, "--json")
    assert "1 of 1 answers were in the file" in second.err
    (document,) = second.documents
    assert document["summaries"] == report["summaries"]
    assert len((tmp_path / "out" / "rows.jsonl").read_text().splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "--suite, --cases or --dataset"),
        (("--suite", "castles"), "suite: expected one of rooms"),
        (("--suite", "rooms", "--seeds", "x"), "seeds: expected numbers"),
        (("--suite", "rooms", "--method", "slow"), "method: expected one of fast"),
        (("--suite", "rooms", "--within", "5"), "within: expected metres and degrees"),
        (("--dataset", "omniscenes"), "expected --root"),
        (("--cases", "nowhere"), "nowhere: expected truth.json"),
        (("fit", "none.jsonl"), "none.jsonl: expected a file of rows"),
    ],
)
def test_wrong_options_are_one_message(panoloc: Panoloc, tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    done = panoloc("evaluate", *arguments, "--out", tmp_path / "out")
    assert done.code == ExitCode.ERROR
    assert said in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "out").exists()


def test_fit_writes_coefficients_and_says_how_they_hold(panoloc: Panoloc, tmp_path: Path) -> None:
    rows = []
    for number in range(40):
        off_m, value = ((0.01, 0.8), (3.0, 0.2))[number % 2]
        rows.append(made_row(number, off_m, group="a" if number < 20 else "b", search=searched(value)))
    file = tmp_path / "rows.jsonl"
    file.write_text("".join(json.dumps(asdict(row)) + "\n" for row in rows))

    done = panoloc("evaluate", "fit", file, "--out", tmp_path / "confidence.json")

    assert done.code == ExitCode.OK, done.err
    assert "a, b" in done.out
    written = json.loads((tmp_path / "confidence.json").read_text())
    assert set(written["coefficients"]) == set(FEATURES)
    assert written["fitted_on"] == {"groups": ["a", "b"], "rows": 40, "right": 20}
    (document,) = panoloc("evaluate", "fit", file, "--out", tmp_path / "again.json", "--json").documents
    assert document["confidence"] == written
    assert document["held_out"]["area_under_roc"] == 1.0


def test_cameras_stand_behind_every_suite_that_names_none_and_cut_every_case(
    cases: Path, panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[list[str]] = []

    def run(scans: Sequence[ScanCases], *_: object) -> None:
        asked.append([scan.name for scan in scans])

    monkeypatch.setattr(evaluation_run, "run_evaluation", run)
    sources = ["--suite", "rooms", "--suite", "night/sweep", "--cases", cases, "--seeds", "4"]
    assert panoloc("evaluate", *sources, "--camera", "photo", "--camera", "frames4").code == ExitCode.OK
    assert asked == [["rooms/photo-4", "rooms/frames4-4", "night/sweep-4", "box/photo", "box/frames4"]]


def test_options_reach_the_cases_and_the_run(
    cases: Path, panoloc: Panoloc, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[tuple[object, ...]] = []
    monkeypatch.setattr(evaluation_run, "run_evaluation", lambda *given: asked.append(given[:-1]))
    sources = ["--suite", "rooms", "--seeds", "1,3", "--family", "nordic", "--width", 256, "--points", 5000]
    sources += ["--cases", cases, "--tag", "day", "--limit", 1]
    methods = ["--method", "fast", "--device", "cpu", "--timeout-s", 3, "--cross", 4, "--change-maps"]
    done = panoloc("evaluate", *sources, *methods, "--out", tmp_path, "--within", "0.05,5")
    assert done.code == ExitCode.OK, done.err
    ((scans, *rest),) = asked
    assert [scan.name for scan in scans] == ["rooms-1-nordic-256px-5000pts", "box"]  # type: ignore[attr-defined]
    unknown = panoloc("evaluate", "--cases", cases, "--tag", "night")
    assert (unknown.code, "tags night, found none" in unknown.err) == (ExitCode.ERROR, True)
    assert rest == [["fast"], RunOptions("cpu", 4, True, 3.0), ["0.05,5"], tmp_path]
