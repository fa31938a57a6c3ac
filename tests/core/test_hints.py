"""Hints: what holds narrows the search, what does not is neither found nor exceeded."""

import pytest

from panoloc.core.options import Hints
from panoloc.core.search.pose_limits import pose_limits
from tests.core.built_maps import BOX, OTHER_BOX, POSE, answer, localized, map_of, panorama, tensors_of
from tests.core.found_pose import assert_found, known

HOLDING = {
    "position": Hints(position_m=(1.9, 2.2, 1.4), radius_m=0.5),
    "region": Hints(region=((1.0, 1.5, 0.8), (2.2, 3.0, 2.0))),
    "upright": Hints(upright=True),
    "small tilt": Hints(max_tilt_deg=12.0),
    "heading a turn further": Hints(heading_deg=120.0 - 360.0, heading_tolerance_deg=30.0),
    "all": Hints((1.9, 2.2, 1.4), 0.6, ((1.0, 1.5, 0.8), (2.2, 3.0, 2.0)), True, None, 140.0, 20.0),
}
WRONG = {
    "wrong position": Hints(position_m=(4.3, 0.7, 1.4), radius_m=0.5),
    "wrong heading": Hints(heading_deg=-50.0, heading_tolerance_deg=30.0),
    "wrong tilt": Hints(max_tilt_deg=4.0),
}
AT_ONCE = ("all", "upright", "wrong position")


def named(hints: dict[str, Hints]) -> list[object]:
    """Return the hints as parameters; most of them are slow."""
    slow = pytest.mark.slow
    return [pytest.param(each, id=name, marks=() if name in AT_ONCE else slow) for name, each in hints.items()]


@pytest.mark.parametrize("hints", named(HOLDING))
def test_a_hint_that_holds_narrows_the_search_and_keeps_the_answer(hints: Hints) -> None:
    found = localized(panorama(), hints=hints)
    assert found.status == "localized"
    assert_found(found, POSE)
    assert found.search.num_poses < answer().search.num_poses


@pytest.mark.parametrize("hints", named(WRONG))
def test_a_wrong_hint_is_not_localized_and_not_exceeded(hints: Hints) -> None:
    found = localized(panorama(), hints=hints, top_k=4)
    assert found.warnings
    assert "hints" in found.warnings[0]
    assert found.status == "not_localized"
    limits = pose_limits(hints, map_of(BOX))  # whose properties are tested apart
    for candidate in (found.best, *found.alternatives):
        if candidate is not None:
            rotation, position = tensors_of(candidate.pose)
            assert bool(limits.allows_position(position, 1e-4))
            assert bool(limits.allows_rotation(rotation, 1e-3))


def test_a_pose_that_a_tilt_much_too_small_holds_is_not_sure_however_well_it_fits_there() -> None:
    found = localized(OTHER_BOX.panorama(POSE), OTHER_BOX, hints=Hints(max_tilt_deg=0.5))
    assert found.status == "not_localized"
    assert known(found.best).confidence < 0.5


def test_a_hint_outside_of_the_map_leaves_nothing_and_says_so() -> None:
    found = localized(panorama(), hints=Hints(position_m=(500.0, 0.0, 0.0), radius_m=1.0))
    assert found.status == "not_localized"
    assert found.best is None
    assert "hints" in found.warnings[0]
