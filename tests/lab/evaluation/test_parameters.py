"""`panoloc evaluate parameters`: what is halved and doubled, and what is told of it; with a localizer that obeys one parameter."""

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.config import LocalizerConfig
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.kernels.library import num_threads, use_threads
from panoloc.core.options import IndexOptions
from panoloc.core.results import Candidate, Localization, SearchSummary
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.lab.evaluation import runner, sources
from panoloc.lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases
from panoloc.lab.evaluation.methods import compared_method
from panoloc.lab.evaluation.parameters import parameters_like, worth_of
from panoloc.service.cli.exit_codes import ExitCode
from tests.lab.evaluation.made_rows import made_row
from tests.service.cli.commands import Panoloc

FAST = compared_method("fast")
SEARCH = LocalizerConfig().search
PARAMETERS = {each.name: each for each in parameters_like(FAST)}


class ObedientLocalizer:
    """Is off by 32 cm times the candidates of its search over those by default, and fails with a larger pool than by default."""

    def __init__(self, config: LocalizerConfig, device: str | None) -> None:
        self._config = config

    def localize(self, rig: Rig, maps: object, **_: object) -> Localization:
        off = 0.32 * self._config.search.num_candidates / SEARCH.num_candidates
        if self._config.search.pool > SEARCH.pool:
            raise MemoryError("too many poses")
        best = Candidate(Pose(np.eye(3), np.array([off, 0, 0])), 0, 0.9, 1.0, 0.1, "rgb", 1)
        return Localization("localized", SearchSummary("fast", 1, 1, 1, 1), {}, best)


@pytest.fixture
def empty_room(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Replace suites by one that has a query for each seed, and maps by nothing."""
    panorama = Panorama(np.zeros((8, 16, 3), np.uint8), np.ones((8, 16), bool))
    query = KnownQuery(Rig.of_panorama(panorama), (Pose(np.eye(3), np.zeros(3)),))
    cloud = PointCloud(np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8), num_points_read=1)
    loaded = LoadedScan(cloud, IndexOptions(), lambda _: query)

    def suite_scans(suite: str, seeds: list[int], **_: Any) -> list[ScanCases]:
        return [ScanCases(f"{suite}-{seed}", suite, ("q",), lambda: loaded, f"seed {seed}") for seed in seeds]

    monkeypatch.setattr(sources, "suite_scans", suite_scans)
    monkeypatch.setattr(runner, "Localizer", ObedientLocalizer)
    built = SimpleNamespace(spacing=0.5, num_points=1, num_starts=1)
    monkeypatch.setattr(runner, "build_map_index", lambda *_, **__: built)
    monkeypatch.setenv("PANOLOC_EVAL_THREADS", "1")
    before = num_threads()
    yield
    use_threads(before)


def test_numbers_are_halved_and_doubled_wherever_they_stand() -> None:
    def values(name: str, section: str) -> list[Any]:
        found = PARAMETERS[name]
        return [None if each is None else getattr(each.config, section) for each in (found.half, found.double)]

    tilt = SEARCH.level_tilt_deg
    assert [search.level_tilt_deg for search in values("search.level_tilt_deg", "search")] == [tilt / 2, tilt * 2]
    stop = LocalizerConfig().refinement.stop
    halved, doubled = (each.stop for each in values("refinement.stop.pixels", "refinement"))
    assert (halved.pixels, doubled.pixels) == (stop.pixels / 2, stop.pixels * 2)
    assert halved.interval == stop.interval
    least, most = LocalizerConfig().focal.bounds
    assert values("focal.bounds", "focal")[1].bounds == (2 * least, 2 * most)


def test_a_field_of_all_rounds_is_changed_together_and_what_is_none_stays_so() -> None:
    double = PARAMETERS["refinement.medium_rounds.robust_scale"].double
    assert double is not None
    rounds = LocalizerConfig().refinement.medium_rounds
    doubled = [None if each.robust_scale is None else 2 * each.robust_scale for each in rounds]
    changed = double.config.refinement.medium_rounds
    assert [each.robust_scale for each in changed] == doubled
    assert [each.rows for each in changed] == [each.rows for each in rounds]


def test_integers_stay_whole_and_above_nothing_and_shares_stay_shares() -> None:
    varied = [m for each in PARAMETERS.values() for m in (each.half, each.double) if m is not None]
    assert len({method.digest for method in varied}) == len({method.name for method in varied}) == len(varied)
    assert PARAMETERS["focal.stated"].half is not None
    assert PARAMETERS["focal.stated"].double is None
    base = compared_method("one=fast:lines.squares=1,search.most_maps=3")
    one, three = parameters_like(base, ["lines.squares", "search.most_maps"])[::-1]
    assert (one.name, one.half) == ("lines.squares", None)
    assert three.half is not None
    assert three.half.config.search.most_maps == 2


def test_the_paper_and_what_a_map_is_built_with_are_left_alone() -> None:
    assert {name.partition(".")[0] for name in PARAMETERS}.isdisjoint({"paper", "descriptors", "aliases"})
    chosen = [each.name for each in parameters_like(FAST, ["focal.stated*", "search.level_tilt_deg"])]
    assert chosen == [name for name in PARAMETERS if name.startswith("focal.stated") or name == "search.level_tilt_deg"]
    with pytest.raises(OptionsError, match=r"only: expected a pattern of parameters such as judge\.\*, got nothing"):
        parameters_like(FAST, ["nothing"])


def test_a_variant_names_fields_of_sections_within_sections() -> None:
    variant = compared_method("x=fast:refinement.stop.pixels=2,search.level_tilt_deg=3")
    assert (variant.config.refinement.stop.pixels, variant.config.search.level_tilt_deg) == (2.0, 3.0)


def test_outcomes_count_what_is_right_wrong_and_another_answer() -> None:
    (sure,) = parameters_like(FAST, ["focal.stated"])
    assert sure.half is not None
    kept = [made_row(0, 0.01), made_row(1, 0.02), made_row(2, 3.0, status="not_localized")]
    half = [made_row(0, 0.01), made_row(1, 0.21), made_row(2, 3.0, seconds=2.0)]
    rows = kept + [made_row(n, r.position_error_m, **_as(sure.half.name, r)) for n, r in enumerate(half)]
    (worth,) = worth_of([sure], FAST, rows)
    assert (worth.same.right, worth.same.localized, worth.same.wrong, worth.same.others) == (2, 2, 0, None)
    assert worth.half is not None
    assert (worth.half.right, worth.half.localized, worth.half.wrong, worth.half.others) == (2, 3, 1, 2)
    assert (worth.half.position_error_m, worth.half.seconds) == (0.21, 1.0)
    assert worth.double is None


def _as(method: str, row: Any) -> dict[str, Any]:
    return {"method": method, "status": row.status, "seconds": row.seconds}


@pytest.mark.usefixtures("empty_room")
def test_a_table_tells_what_each_is_worth_and_a_second_run_reuses_the_rows(panoloc: Panoloc, tmp_path: Path) -> None:
    arguments = ["evaluate", "parameters", "--suite", "rooms", "--seeds", "1-3", "--out", str(tmp_path)]
    arguments += ["--only", "search.num_candidates", "--only", "search.pool", "--only", "focal.stated"]
    first = panoloc(*arguments)
    assert first.code == ExitCode.OK, first.err
    lines = {
        line.split()[0]: line.split()[1:] for line in first.out.splitlines() if line.startswith(("search", "focal"))
    }
    # 16, 32 and 64 cm off: right is within 30 cm, wrong beyond 50.
    figures = [*"300", *"333", *"003", "0.1600", "0.3200", "0.6400"]
    assert lines["search.num_candidates"][:13] == [str(SEARCH.num_candidates), *figures]
    assert lines["search.num_candidates"][-2:] == ["6", "0"]
    assert lines["focal.stated"][-2:] == ["0", "0"]
    assert lines["search.pool"][-2:] == ["3", "3"]
    assert (tmp_path / "parameters.txt").read_text().split() == first.out.split()

    second = panoloc(*arguments, "--json")
    assert "18 of 18 answers were in the file" in second.err
    (document,) = second.documents
    assert document["parameters"] == json.loads((tmp_path / "parameters.json").read_text())
    assert [each["as_it_is"]["right"] for each in document["parameters"]] == [0, 0, 0]


def test_an_unknown_parameter_is_one_message(panoloc: Panoloc, tmp_path: Path) -> None:
    done = panoloc("evaluate", "parameters", "--suite", "rooms", "--only", "judge.no", "--out", tmp_path / "out")
    assert (done.code, (tmp_path / "out").exists()) == (ExitCode.ERROR, False)
    assert "only: expected a pattern" in done.err
