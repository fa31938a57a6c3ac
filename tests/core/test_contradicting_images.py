"""Images of a session that do not agree with the pose that fits the others."""

import numpy as np
import pytest

from core.config import JudgeConfig
from core.geometry.pose import Pose
from core.judge.doubts import Doubts
from core.judge.photo_agreement import PhotoAgreement
from core.options import Status
from core.results import Candidate, Localization, SearchSummary


def photos(agreements: list[float | None]) -> list[PhotoAgreement | None]:
    """Return photos that show much, and agree so much with the pose of all of them, everywhere alike."""
    return [None if each is None else PhotoAgreement(each, float(each >= 0.5), 0.3) for each in agreements]


@pytest.mark.parametrize(
    ("agreements", "status"),
    [
        ([0.9, 0.8, 0.5, 0.7], "localized"),
        ([0.9, 0.35, 0.5, 0.7], "localized"),  # one of four, and not the one whose pose is the answer
        ([0.35, 0.9, 0.5, 0.7], "not_localized"),
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
    answer = Doubts(JudgeConfig(), 0.6).unless_contradicted(found, photos(agreements))
    assert answer.status == status
    assert answer.best is not None
    assert (answer.best.confidence < 0.5) == (status == "not_localized")
    disagree = any(each is not None and each < 0.45 for each in agreements) and len(agreements) > 1
    assert bool(answer.warnings) == disagree


def unsure(agreements: list[float | None], status: Status) -> Localization:
    """Return the answer to images that agree so much with the pose found."""
    best = Candidate(
        Pose(np.eye(3), np.zeros(3)), 0, 0.3 if status == "not_localized" else 0.95, 1.0, 0.1, "equalized", 40
    )
    found = Localization(status, SearchSummary("fast", 1, 10, 100, 1000), {}, best=best)
    return Doubts(JudgeConfig(), 0.6).unless_contradicted(found, photos(agreements))


def test_where_nothing_is_localized_images_that_contradict_one_that_fits_are_named_too() -> None:
    answer = unsure([0.5, 0.9, 0.1, -0.1], "not_localized")
    assert answer.status == "not_localized"
    assert answer.best is not None
    assert answer.best.confidence == 0.3
    (warning,) = answer.warnings
    assert warning.startswith("images 3 and 4 of 4 do not agree with the pose that fits the others")


def test_images_of_another_place_contradict_nothing() -> None:
    assert unsure([0.4, 0.1, 0.0, -0.1], "not_localized").warnings == ()
    assert unsure([None, None, 0.1], "not_localized").warnings == ()


def test_one_image_that_disagrees_is_named_by_its_number() -> None:
    (warning,) = unsure([0.9, 0.9, 0.9, 0.9, 0.9, 0.1], "localized").warnings
    assert warning.startswith("image 6 of 6 does not agree with the pose that fits the others; check frame, its")
