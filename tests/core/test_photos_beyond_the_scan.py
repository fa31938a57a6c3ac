"""Photos at whose best pose the scan has little of what they show."""

from dataclasses import replace

import numpy as np
import pytest

from core.config import JudgeConfig, LocalizerConfig
from core.geometry.pose import Pose
from core.index.map_index import MapIndex
from core.judge.doubts import Doubts
from core.localizer import Localizer
from core.options import Status
from core.results import Candidate, Evidence, Localization, SearchSummary
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import FOUR, UPRIGHT, session_of


def found(confidence: float, compared: float, status: Status = "localized") -> Localization:
    best = Candidate(Pose(np.eye(3), np.zeros(3)), 0, confidence, 1.0, 0.1, "equalized", 40)
    evidence = Evidence({"relative_coverage": compared}, None, None)
    return Localization(status, SearchSummary("fast", 1, 10, 100, 1000), {}, best=best, evidence=evidence)


@pytest.mark.parametrize(
    ("confidence", "compared", "status"),
    [
        (0.7, 0.2, "not_localized"),
        (0.95, 0.2, "localized"),  # what the scan has fits too well for chance
        (0.7, 0.5, "localized"),
    ],
)
def test_little_that_fits_hardly_is_not_enough(confidence: float, compared: float, status: Status) -> None:
    answer = Doubts(JudgeConfig(), 0.6).unless_seen_little_of(found(confidence, compared))
    assert answer.status == status
    assert answer.best is not None
    assert (answer.best.confidence < 0.5) == (status == "not_localized")
    assert [words for words in answer.warnings if "only 20% of what the images show" in words] == list(answer.warnings)
    assert bool(answer.warnings) == (status == "not_localized")


@pytest.mark.parametrize("status", ["ambiguous", "not_localized"])
def test_who_says_nothing_for_sure_needs_no_warning(status: Status) -> None:
    before = found(0.3, 0.1, status)
    assert Doubts(JudgeConfig(), 0.6).unless_seen_little_of(before) is before


@pytest.mark.slow
def test_frames_are_asked_for_how_much_of_them_the_scan_has(localizer: Localizer, box_index: MapIndex) -> None:
    asked = session_of(PaintedBox(seed=3), Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2])), FOUR, [UPRIGHT] * 4)
    answer = localizer.localize(asked, [box_index])
    assert answer.status == "localized"
    assert answer.evidence is not None
    assert answer.evidence.measures["relative_coverage"] > 0.6
    assert answer.warnings == ()
    config = LocalizerConfig()
    strict = replace(config, judge=replace(config.judge, least_compared=0.99, sure_of_little=1.1))
    refused = Localizer(strict, device="cpu").localize(asked, [box_index])
    assert refused.status == "not_localized"
    (words,) = refused.warnings
    assert "of what the images show" in words
