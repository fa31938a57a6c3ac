"""How well each photo of a session agrees with the pose found for all: two photos of a painted box, spoilt in several ways."""

from dataclasses import replace

import numpy as np
import pytest

from panoloc.core.camera.rig import Rig
from panoloc.core.config import DescriptorConfig, JudgeConfig
from panoloc.core.decide.agreement import PhotoAgreement, agreement_by_photo
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.rig_pyramid import RigPyramid
from panoloc.core.render.comparison import Comparison, RigView
from tests.core.built_maps import BOX, map_of, tensors_of
from tests.core.image.painted_photos import OF_TWO, TWO, rig_pose
from tests.core.painted_box import rotation_of

JUDGE = JudgeConfig()
DESCRIPTORS = DescriptorConfig()
SESSION = OF_TWO
SECOND = SESSION.images[1]
COLOR = SECOND.photo.color


def compared(rig: Rig) -> Comparison:
    view = RigView(RigPyramid(rig, 512, None, "cpu"), 8.0)
    return view.compare(map_of(BOX).render_cloud, *tensors_of(rig_pose(rig)), 128)


def agreements(color: np.ndarray = COLOR, at: Pose = TWO[1]) -> tuple[PhotoAgreement, PhotoAgreement]:
    """Return those of the session whose second photo shows something, taken at some place in the session."""
    second = replace(SECOND, photo=replace(SECOND.photo, color=color), session_from_camera=at)
    first, other = agreement_by_photo(
        compared(replace(SESSION, images=(SESSION.images[0], second))), 2, JUDGE, DESCRIPTORS
    )
    assert first is not None
    assert other is not None
    return first, other


def test_photos_at_their_places_agree() -> None:
    for each in agreements():
        assert each.correlation > 0.9
        assert each.agreeing_share > 0.9
        assert not each.contradicts(JUDGE)


def test_one_that_looks_elsewhere_contradicts_and_the_other_does_not() -> None:
    good, bad = agreements(at=Pose(rotation_of(140.0), TWO[1].position))
    assert good.correlation > 0.8
    assert not good.contradicts(JUDGE)
    assert bad.correlation < 0.2
    assert bad.agreeing_share < 0.2
    assert bad.contradicts(JUDGE)


def test_one_in_which_most_has_changed_but_not_all_contradicts_nothing() -> None:
    spoilt, columns = COLOR.copy(), round(0.65 * COLOR.shape[1])
    spoilt[:, :columns] = np.where(COLOR[:, :columns].mean(-1, keepdims=True) > 128, 0, 255)
    _, found = agreements(spoilt)
    assert found.correlation < 0.2  # the rest is drowned in it
    assert 0.2 < found.agreeing_share < 0.5
    assert not found.contradicts(JUDGE)


def test_one_that_shows_nothing_but_a_plain_thing_before_the_lens_contradicts_nothing() -> None:
    _, found = agreements(np.full_like(COLOR, 90))
    assert found.correlation < 0.2
    assert found.contrast < 0.05
    assert not found.contradicts(JUDGE)


@pytest.mark.parametrize(
    ("measured", "contradicts"),
    [
        (PhotoAgreement(0.44, 0.19, 0.15), True),
        (PhotoAgreement(0.45, 0.19, 0.15), False),
        (PhotoAgreement(0.19, 0.2, 0.15), False),
        (PhotoAgreement(0.44, 0.19, 0.149), False),
        (PhotoAgreement(-0.9, 0.0, 0.5), True),
    ],
)
def test_all_three_signs_have_to_speak_against_it(measured: PhotoAgreement, contradicts: bool) -> None:
    assert measured.contradicts(JUDGE) == contradicts


def test_nothing_is_told_of_a_photo_that_shows_nothing_of_the_scan() -> None:
    assert agreement_by_photo(compared(SESSION), 3, JUDGE, DESCRIPTORS)[2] is None
    assert agreement_by_photo(None, 2, JUDGE, DESCRIPTORS) == [None, None]
