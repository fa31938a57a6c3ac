"""Images of a session that do not agree with the pose that fits the others."""

import numpy as np
import pytest

from core.geometry.pose import Pose
from core.localizer import Localizer
from core.results import Candidate, Localization, SearchSummary


@pytest.mark.parametrize(
    ("agreements", "status"),
    [
        ([0.9, 0.8, 0.4, 0.7], "localized"),
        ([0.9, 0.05, 0.4, 0.7], "localized"),  # one of four, and not the one whose pose is the answer
        ([0.05, 0.9, 0.4, 0.7], "not_localized"),
        ([0.9, 0.05, 0.08, 0.9], "not_localized"),
        ([0.9, None, None, 0.9], "localized"),  # nothing of the scan in view is no contradiction
        ([0.1], "localized"),  # alone it has nothing to contradict; its confidence says how well it fits
    ],
)
def test_more_than_a_few_images_that_disagree_or_the_first_make_a_session_unsure(
    agreements: list[float | None], status: str
) -> None:
    best = Candidate(Pose(np.eye(3), np.zeros(3)), 0, 0.95, 1.0, 0.1, "equalized", 40)
    found = Localization("localized", SearchSummary("fast", 1, 10, 100, 1000), {}, best=best)
    localizer = Localizer(device="cpu")
    answer = localizer._unless_contradicted(found, agreements)
    assert answer.status == status
    assert answer.best is not None
    assert (answer.best.confidence < 0.5) == (status == "not_localized")
    disagree = any(each is not None and each < 0.2 for each in agreements) and len(agreements) > 1
    assert bool(answer.warnings) == disagree
