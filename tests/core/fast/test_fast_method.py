"""When the search for photos ends: once an answer is sure enough for what was looked at by then."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch

from core.camera.camera import Camera
from core.config import LocalizerConfig
from core.fast.fast_method import FastMethod
from core.geometry.pose import Pose
from core.index.map_index import MapIndex
from core.judge.confidence import load_confidence_model
from core.judge.hypotheses import Hypothesis
from core.judge.verdict import Verdict
from core.options import Status
from core.panorama.session import Session
from core.prepared_query import MapQuery
from core.search.closer_look import search_around
from core.search.photo_search import search_photos
from core.stage_clock import StageClock
from tests.core.painted_box import PaintedBox
from tests.core.panorama.painted_photos import UPRIGHT, photo_of

pytestmark = pytest.mark.slow
CPU = torch.device("cpu")
CONFIG = LocalizerConfig()
SEARCH = replace(CONFIG.photo_search, level_candidates=5, num_candidates=6, first_portion=2, lookalikes=0)
VERY_WIDE = Camera.from_hfov("pinhole", 640, 480, 130.0)


@pytest.mark.parametrize(
    ("status", "together", "searches", "portions"),
    [
        ("localized", SEARCH.sure, 1, 1),
        ("ambiguous", SEARCH.sure, 1, 1),
        ("localized", SEARCH.sure_at_end, 1, 2),
        ("ambiguous", SEARCH.sure_at_end, 2, 4),
        ("localized", SEARCH.sure_at_end - 0.01, 2, 4),
        ("not_localized", 0.5, 2, 4),
    ],
)
def test_the_less_sure_an_answer_is_the_more_is_looked_at(
    box: PaintedBox,
    box_index: MapIndex,
    box_pose: Pose,
    monkeypatch: pytest.MonkeyPatch,
    status: Status,
    together: float,
    searches: int,
    portions: int,
) -> None:
    done = {"searches": 0, "verdicts": 0}

    def searched(*given: Any) -> Any:
        done["searches"] += 1
        return search_photos(*given)

    monkeypatch.setattr("core.fast.fast_method.search_photos", searched)
    monkeypatch.setattr(
        "core.fast.fast_method.verdict", lambda hypotheses, *_: Verdict(list(hypotheses), [together], status, together)
    )
    finish = FastMethod.is_sure

    def counted(method: FastMethod, hypotheses: Any, is_last: bool = False) -> bool:
        done["verdicts"] += not is_last
        return finish(method, hypotheses, is_last)

    monkeypatch.setattr(FastMethod, "is_sure", counted)
    method = FastMethod(replace(CONFIG, photo_search=SEARCH), CPU, load_confidence_model())
    photo = Session.of_photo(photo_of(box, UPRIGHT, box_pose))
    assert method.run(photo, [box_index], None, StageClock(None, CPU)).hypotheses
    assert (done["searches"], done["verdicts"]) == (searches, portions)


@pytest.mark.parametrize(
    ("together", "is_weighed"), [(SEARCH.sure, False), (CONFIG.judge.photos_weighed_below - 0.01, True)]
)
def test_all_evidence_ranks_places_where_nothing_is_sure(
    box: PaintedBox,
    box_index: MapIndex,
    box_pose: Pose,
    monkeypatch: pytest.MonkeyPatch,
    together: float,
    is_weighed: bool,
) -> None:
    asked: list[Hypothesis] = []
    monkeypatch.setattr(
        "core.fast.fast_method.verdict",
        lambda hypotheses, *_: Verdict(list(hypotheses), [together], "localized", together),
    )

    def evidence(_: FastMethod, hypothesis: Hypothesis) -> float:
        asked.append(hypothesis)
        return hypothesis.score

    monkeypatch.setattr(FastMethod, "evidence", evidence)
    method = FastMethod(replace(CONFIG, photo_search=SEARCH), CPU, load_confidence_model())
    photo = Session.of_photo(photo_of(box, UPRIGHT, box_pose))
    assert method.run(photo, [box_index], None, StageClock(None, CPU)).hypotheses
    assert bool(asked) == is_weighed


def test_evidence_grows_with_what_speaks_for_a_pose() -> None:
    method = FastMethod(CONFIG, CPU, load_confidence_model())
    measures = {"patch_correlation": 0.3, "halves_apart_m": 0.1, "halves_apart_deg": 2.0, "lines": 0.8}
    usual = Hypothesis(0, 0, torch.eye(3), torch.zeros(3), score=0.2, measures=measures)

    def with_one(**other: float) -> float:
        return method.evidence(replace(usual, measures=measures | other))

    assert with_one(patch_correlation=0.4) > with_one() > with_one(halves_apart_m=0.3)
    assert with_one(lines=1.0) > with_one()
    assert with_one(distinctness=0.0) == with_one()  # that is of the place and the others


@pytest.mark.parametrize(
    ("camera", "together", "explained", "is_held_back", "looks"),
    [
        (UPRIGHT, SEARCH.beyond_doubt - 0.01, 0.0, False, 1),
        (UPRIGHT, SEARCH.beyond_doubt, 0.0, False, 0),
        (UPRIGHT, SEARCH.beyond_doubt, 1.01, False, 1),
        (UPRIGHT, SEARCH.beyond_doubt, 0.0, True, 1),
        (VERY_WIDE, 0.95, 0.0, False, 0),
        (VERY_WIDE, SEARCH.beyond_doubt, 0.0, True, 1),
    ],
    ids=["in doubt", "beyond doubt", "explains little", "turned back", "shows much", "shows much, turned back"],
)
def test_an_answer_that_is_not_beyond_doubt_gets_a_closer_look(
    box: PaintedBox,
    box_index: MapIndex,
    box_pose: Pose,
    monkeypatch: pytest.MonkeyPatch,
    camera: Camera,
    together: float,
    explained: float,
    is_held_back: bool,
    looks: int,
) -> None:
    looked: list[Any] = []
    within_limits = MapQuery.within_limits

    def looked_around(*given: Any) -> Any:
        looked.append(given)
        return search_around(*given)

    def judged(hypotheses: Sequence[Hypothesis], *_: Any) -> Verdict:
        confidence = 0.0 if hypotheses[0].is_held_back else together
        return Verdict(list(hypotheses), [confidence], "localized" if confidence else "not_localized", confidence)

    monkeypatch.setattr("core.fast.fast_method.search_around", looked_around)
    monkeypatch.setattr("core.fast.fast_method.verdict", judged)
    monkeypatch.setattr(
        MapQuery, "within_limits", lambda *given: replace(within_limits(*given), is_held_back=is_held_back)
    )
    search = replace(SEARCH, doubtful_explained=explained)
    method = FastMethod(replace(CONFIG, photo_search=search), CPU, load_confidence_model())
    photo = Session.of_photo(photo_of(box, camera, box_pose))
    found = method.run(photo, [box_index], None, StageClock(None, CPU)).hypotheses[0]
    assert len(looked) == looks
    assert (
        float((found.position + torch.from_numpy(box_index.origin_offset) - torch.from_numpy(box_pose.position)).norm())
        < 0.1
    )
