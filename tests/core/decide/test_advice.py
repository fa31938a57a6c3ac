"""What callers are told to do where an answer tells no place, or several."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.decide.verdict import accuracy_too_low, why_nothing_fits, why_there_is_no_pose, with_advice
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Hints, Status
from panoloc.core.remarks import Remark
from panoloc.core.results import Candidate, Localization, SearchSummary

GIVEN, ALONE = Hints(upright=True), Pose(np.eye(3), np.zeros(3))
PHOTO = Photo(np.zeros((3, 4, 3), np.uint8), np.ones((3, 4), bool), Camera.from_hfov("pinhole", 4, 3, 60.0))
ONE, SEVERAL = Rig.of_photo(PHOTO), Rig((RigImage(PHOTO, ALONE), RigImage(PHOTO, ALONE)))
SEARCHED = Rig.of_photo(replace(PHOTO, hfov_range_deg=(50.0, 70.0)))
WHOLE = Rig.of_panorama(Panorama(np.zeros((4, 8, 3), np.uint8), np.ones((4, 8), bool)))
FOUND = Candidate(ALONE, 0, 0.5, 1.0, 0.1, "equalized", 40)


def answer(status: Status, best: Candidate | None = FOUND, num_poses: int = 9) -> Localization:
    return Localization(status, SearchSummary("fast", 1, 10, 100, num_poses), {}, best=best)


def reasons(remarks: tuple[Remark, ...]) -> list[str]:
    return [remark.reason for remark in remarks]


@pytest.mark.parametrize(
    ("rig", "reason", "words"),
    [
        (ONE, "check_camera", "(hfov_range_deg, --hfov 45-90)"),
        (SEARCHED, "check_camera", "hfov_deg, --hfov 69"),  # its field of view was searched already
        (SEVERAL, "check_camera", "session_from_camera"),
        (WHOLE, "check_image", "full sphere"),
    ],
)
def test_what_fits_nowhere_is_said_with_what_may_be_wrong(rig: Rig, reason: str, words: str) -> None:
    (said,) = why_nothing_fits(rig, None)
    assert said.reason == reason
    assert words in said
    assert reasons(why_nothing_fits(rig, GIVEN)) == ["widen_hints", reason]
    assert with_advice(answer("not_localized"), rig, GIVEN).warnings == why_nothing_fits(rig, GIVEN)


def test_only_who_sent_hints_is_told_to_widen_them_where_no_pose_is_left() -> None:
    for num_poses, hints, said in (
        (9, None, ["nothing_in_reach"]),
        (9, Hints(), ["nothing_in_reach"]),
        (9, GIVEN, ["widen_hints", "nothing_in_reach"]),
        (1, GIVEN, ["widen_hints", "nothing_in_reach"]),
        (0, GIVEN, ["widen_hints"]),
    ):
        assert reasons(why_there_is_no_pose(num_poses, hints)) == said
        assert reasons(with_advice(answer("not_localized", None, num_poses), ONE, hints).warnings) == said


def test_a_place_that_is_told_needs_no_advice_and_several_need_another_image() -> None:
    assert with_advice(answer("localized"), ONE, GIVEN).warnings == ()
    assert reasons(with_advice(answer("ambiguous"), ONE, GIVEN).warnings) == ["places_look_alike"]


def test_who_was_warned_is_not_told_to_guess_as_well() -> None:
    warned = answer("not_localized").warned(Remark("turn_more", "a plain wall"))
    assert with_advice(warned, ONE, GIVEN).warnings == warned.warnings


def test_what_of_an_image_was_left_out_is_said_of_every_answer() -> None:
    cropped = Rig.of_photo(replace(PHOTO, left_out=("the tripod",)))
    (said,) = with_advice(answer("localized"), cropped, None).warnings
    assert (said.reason, "the tripod" in said) == ("regions_ignored", True)


def test_the_tracking_is_blamed_only_where_there_is_any() -> None:
    assert "position_noise_m" not in accuracy_too_low(ONE)
    assert "position_noise_m" in accuracy_too_low(SEVERAL)


def test_intrinsics_are_asked_of_those_who_gave_none() -> None:
    assert "fx_px" not in accuracy_too_low(ONE)
    stated = Rig.of_photo(replace(PHOTO, focal_uncertainty=0.006))
    assert "fx_px" in accuracy_too_low(stated)
    assert accuracy_too_low(stated) == accuracy_too_low(SEARCHED)
