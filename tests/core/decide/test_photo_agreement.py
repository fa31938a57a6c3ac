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
    first, other = agreement_by_photo(compared(replace(SESSION, images=(SESSION.images[0], second))), 2, DESCRIPTORS)
    assert first is not None
    assert other is not None
    return first, other


def test_photos_at_their_places_agree() -> None:
    for each in agreements():
        assert each.correlation > 0.9
        assert each.explained > 0.4
        assert not each.contradicts(JUDGE)


def test_one_that_looks_elsewhere_contradicts_and_the_other_does_not() -> None:
    good, bad = agreements(at=Pose(rotation_of(140.0), TWO[1].position))
    assert good.correlation > 0.8
    assert not good.contradicts(JUDGE)
    assert bad.correlation < 0.2
    assert bad.explained < 0.03
    assert bad.contradicts(JUDGE)


def test_one_in_which_most_has_changed_but_not_all_contradicts_nothing() -> None:
    spoilt, columns = COLOR.copy(), round(0.65 * COLOR.shape[1])
    spoilt[:, :columns] = np.where(COLOR[:, :columns].mean(-1, keepdims=True) > 128, 0, 255)
    _, found = agreements(spoilt)
    assert found.correlation < 0.2  # the rest is drowned in it
    assert 0.1 < found.explained < 0.2
    assert not found.contradicts(JUDGE)


def test_one_that_shows_nothing_but_a_plain_thing_before_the_lens_contradicts_nothing() -> None:
    _, found = agreements(np.full_like(COLOR, 90))
    assert found.correlation < 0.2
    assert found.contrast < 0.05
    assert not found.contradicts(JUDGE)


@pytest.mark.parametrize(
    ("explained", "contrast", "contradicts"),
    [
        (0.0, 0.3, True),
        (0.05, 0.3, True),
        (0.06, 0.3, False),
        (0.03, 0.3, True),
        (0.03, 0.15, False),
        (0.0, 0.03, False),
    ],
)
def test_the_more_a_photo_shows_the_more_of_it_the_scan_has_to_explain(
    explained: float, contrast: float, contradicts: bool
) -> None:
    assert PhotoAgreement(0.0, explained, contrast).contradicts(JUDGE) == contradicts


def test_nothing_is_told_of_a_photo_that_shows_nothing_of_the_scan() -> None:
    assert agreement_by_photo(compared(SESSION), 3, DESCRIPTORS)[2] is None
