"""How well each photo of a session agrees with the pose found for all: two photos of a painted box, spoilt in several ways."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.config import JudgeConfig
from panoloc.core.geometry.pose import Pose
from panoloc.core.index.map_index import MapIndex
from panoloc.core.judge.photo_agreement import PhotoAgreement, agreement_by_photo
from panoloc.core.panorama.photo_atlas import PhotoAtlas
from panoloc.core.panorama.session import Session, SessionImage, session_from_rig
from panoloc.core.views.comparison import Comparison
from panoloc.core.views.photo_comparison import RigView
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.panorama.painted_photos import SIDEWAYS, TWO, UPRIGHT, session_of

JUDGE = JudgeConfig()
MAP_FROM_SESSION = Pose(rotation_of(40.0), np.array([0.4, -0.1, 1.2]))


@pytest.fixture(scope="module")
def session(box: PaintedBox) -> Session:
    return session_of(box, MAP_FROM_SESSION, TWO, (UPRIGHT, SIDEWAYS))


def compared(session: Session, index: MapIndex) -> Comparison:
    rig = MAP_FROM_SESSION.after(session_from_rig(session))
    rotation, position = (torch.from_numpy(each).float()[None] for each in (rig.rotation, rig.position))
    view = RigView(PhotoAtlas(session, 512, None, "cpu"), 8.0)
    return view.compare(index.render_cloud, rotation, position, 128, is_labels=False)


def agreements(session: Session, index: MapIndex) -> tuple[PhotoAgreement, PhotoAgreement]:
    first, second = agreement_by_photo(compared(session, index), 2, JUDGE)
    assert first is not None
    assert second is not None
    return first, second


def with_second(session: Session, image: SessionImage) -> Session:
    return replace(session, images=(session.images[0], image))


def painted(session: Session, color: np.ndarray, share: float) -> Session:
    """Return a session whose second photo shows something else in a share of its columns."""
    image = session.images[1]
    spoilt = image.photo.color.copy()
    spoilt[:, : round(share * spoilt.shape[1])] = color[:, : round(share * spoilt.shape[1])]
    return with_second(session, replace(image, photo=replace(image.photo, color=spoilt)))


def test_photos_at_their_places_agree(session: Session, box_index: MapIndex) -> None:
    for each in agreements(session, box_index):
        assert each.correlation > 0.9
        assert each.agreeing_share > 0.9
        assert not each.contradicts(JUDGE)


def test_one_that_looks_elsewhere_contradicts_and_the_other_does_not(session: Session, box_index: MapIndex) -> None:
    image = session.images[1]
    turned = SessionImage(image.photo, Pose(rotation_of(140.0), image.session_from_camera.position))
    good, bad = agreements(with_second(session, turned), box_index)
    assert good.correlation > 0.8
    assert not good.contradicts(JUDGE)
    assert bad.correlation < 0.2
    assert bad.agreeing_share < 0.2
    assert bad.contradicts(JUDGE)


def test_one_in_which_most_has_changed_but_not_all_contradicts_nothing(session: Session, box_index: MapIndex) -> None:
    black_and_white = np.where(session.images[1].photo.color.mean(-1, keepdims=True) > 128, 0, 255).astype(np.uint8)
    _, found = agreements(
        painted(session, np.broadcast_to(black_and_white, session.images[1].photo.color.shape), 0.65), box_index
    )
    assert found.correlation < 0.2  # the rest is drowned in it
    assert 0.2 < found.agreeing_share < 0.5
    assert not found.contradicts(JUDGE)


def test_one_that_shows_nothing_but_a_plain_thing_before_the_lens_contradicts_nothing(
    session: Session, box_index: MapIndex
) -> None:
    plain = np.full_like(session.images[1].photo.color, 90)
    _, found = agreements(painted(session, plain, 1.0), box_index)
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


def test_nothing_is_told_of_a_photo_that_shows_nothing_of_the_scan(session: Session, box_index: MapIndex) -> None:
    assert agreement_by_photo(compared(session, box_index), 3, JUDGE)[2] is None
    assert agreement_by_photo(None, 2, JUDGE) == [None, None]
