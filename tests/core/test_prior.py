"""A pose that the caller expects: it saves the search where it holds, and changes nothing where it does not."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera
from panoloc.core.config import LocalizerConfig
from panoloc.core.decide.confidence import load_confidence_model
from panoloc.core.decide.verdict import Doubts
from panoloc.core.geometry.pose import Pose
from panoloc.core.geometry.rotations import rotation_angle, rotation_from_vector
from panoloc.core.localizer import Localizer
from panoloc.core.options import Frame, Hints, PosePrior
from panoloc.core.query.rounds import poses_of_prior
from panoloc.core.results import Localization
from tests.core.built_maps import BOX, COARSE, OTHER_BOX, POSE, SYMMETRIC, answer, localized, map_of, panorama, rig_of
from tests.core.found_pose import assert_found, best_of, known
from tests.core.image.painted_photos import FOUR, MAP_FROM_SESSION, photo_of, session_of
from tests.core.search.found_candidates import RIGS, query, query_of


def expected(pose: Pose, frame: Frame = "ros") -> Hints:
    """Return a prior, in the axes of a frame."""
    given = pose.in_frame(frame)
    x, y, z, w = given.quaternion_xyzw.tolist()
    return Hints(prior=PosePrior(tuple(given.position.tolist()), (x, y, z, w), frame))


def moved(pose: Pose, metres: tuple[float, float, float], yaw_deg: float) -> Pose:
    """Return a pose beside another one."""
    turn = rotation_from_vector(torch.tensor([0.0, 0.0, math.radians(yaw_deg)], dtype=torch.float64)).numpy()
    return Pose(turn @ pose.rotation, pose.position + np.array(metres))


@pytest.mark.parametrize("frame", ["ros", "opencv", "webxr", "unity"])
def test_where_a_prior_holds_nothing_is_searched(frame: Frame) -> None:
    found = localized(panorama(), hints=expected(moved(POSE, (0.2, -0.15, 0.05), 4.0), frame))
    assert (found.status, found.search.num_starts, found.search.num_poses) == ("localized", 0, 0)
    assert_found(found, POSE)
    # Less sure than after a search: nobody has looked elsewhere.
    assert best_of(found).confidence <= best_of(answer()).confidence
    assert known(found.evidence).features["margin"] == LocalizerConfig().refinement.margin


def test_with_a_prior_no_field_of_view_of_a_photo_is_searched_either() -> None:
    photo = replace(photo_of(Camera.from_hfov("pinhole", 640, 480, 92.0)), hfov_range_deg=(60.0, 100.0))
    found = localized(photo, hints=expected(moved(POSE, (0.1, -0.1, 0.05), 3.0)))
    assert (found.status, found.search.num_starts) == ("localized", 0)
    assert_found(found, POSE)


def test_where_an_answer_from_a_prior_is_refused_after_all_everything_is_searched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(doubts: Doubts, found: Localization, edges_deg: float | None) -> Localization:
        return found if found.search.num_starts else replace(found, status="not_localized")

    monkeypatch.setattr(Doubts, "unless_plain", refuse)
    found = localized(panorama(), hints=expected(POSE))
    assert found.status == "localized"
    assert found.search.num_starts > 0


def test_beside_the_only_prior_nothing_is_searched_even_where_nothing_fits_there() -> None:
    prior = known(expected(moved(POSE, (2.0, -1.0, 0.0), 120.0)).prior)
    found = localized(panorama(), hints=Hints(prior=replace(prior, is_only=True)))
    assert (found.status, found.search.num_starts, found.search.num_poses) == ("not_localized", 0, 0)
    assert np.linalg.norm(best_of(found).pose.position - prior.position_m) < 1.5


@pytest.mark.slow
def test_an_uncertain_prior_is_looked_at_from_several_sides() -> None:
    prior = expected(moved(POSE, (0.7, -0.5, 0.0), 8.0)).prior
    found = localized(panorama(), hints=Hints(prior=replace(known(prior), position_std_m=0.7)))
    assert (found.status, found.search.num_starts) == ("localized", 0)
    assert_found(found, POSE)


@pytest.mark.slow
def test_a_prior_of_an_uncertain_heading_is_turned_both_ways() -> None:
    prior = known(expected(moved(POSE, (0.1, 0.0, 0.0), 38.0)).prior)
    found = localized(panorama(), hints=Hints(prior=replace(prior, orientation_std_deg=40.0)))
    assert (found.status, found.search.num_starts) == ("localized", 0)
    assert_found(found, POSE)


@pytest.mark.slow
@pytest.mark.parametrize("metres", [(2.0, -1.0, 0.0), (500.0, 0.0, 0.0)])
def test_a_wrong_prior_changes_no_answer(metres: tuple[float, float, float]) -> None:
    found = localized(panorama(), hints=expected(moved(POSE, metres, 120.0)))
    assert (found.status, found.search.num_starts) == ("localized", answer().search.num_starts)
    assert_found(found, POSE)
    assert best_of(found).confidence == pytest.approx(best_of(answer()).confidence, abs=0.01)
    assert known(found.evidence).features["margin"] > LocalizerConfig().refinement.margin


@pytest.mark.slow
def test_what_is_not_localized_where_it_was_expected_is_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    doubting = replace(load_confidence_model(), threshold=2.0)
    monkeypatch.setattr("panoloc.core.localizer.load_confidence_model", lambda: doubting)
    found = Localizer(device="cpu").localize(rig_of(panorama()), [map_of(BOX, COARSE)], hints=expected(POSE))
    assert found.search.num_starts == answer().search.num_starts


def test_what_is_localized_where_it_was_expected_but_not_surely_is_searched() -> None:
    config = LocalizerConfig()
    doubting = Localizer(replace(config, judge=replace(config.judge, sure=2.0)), device="cpu")
    found = doubting.localize(rig_of(panorama()), [map_of(BOX, COARSE)], hints=expected(POSE))
    assert (found.status, found.search.num_starts) == ("localized", answer().search.num_starts)


@pytest.mark.parametrize("name", list(RIGS))
@pytest.mark.parametrize(("std_m", "places"), [(0.29, 1), (0.3, 5), (0.7, 5), (5.0, 5)])
@pytest.mark.parametrize(("std_deg", "turns_deg"), [(5.0, []), (12.0, [12.0, 12.0]), (60.0, [30.0, 30.0])])
def test_the_rig_begins_where_its_first_camera_is_expected_beside_it_and_turned(
    name: str, std_m: float, places: int, std_deg: float, turns_deg: list[float]
) -> None:
    _, pose = RIGS[name]
    where = query(name)
    turn, middle = (each[0].double().numpy() for each in (where.rig.pyramid.rotations, where.rig.pyramid.centers))
    prior = known(expected(pose.after(Pose(turn, middle))).prior)
    found = poses_of_prior(where, replace(prior, position_std_m=std_m, orientation_std_deg=std_deg))
    assert len(found) == places + len(turns_deg)
    np.testing.assert_allclose(found[0].rotation.numpy(), pose.rotation, atol=1e-5)
    np.testing.assert_allclose(found[0].position.numpy(), pose.position, atol=1e-5)
    turns = [math.degrees(float(rotation_angle(each.rotation, found[0].rotation))) for each in found[places:]]
    assert turns == pytest.approx(turns_deg, abs=0.1)
    reach = [float((each.position - found[0].position).norm()) for each in found[1:places]]
    assert reach == pytest.approx([min(std_m, 1.5)] * (places - 1), abs=1e-5)


def test_no_pose_begins_where_the_hints_allow_none() -> None:
    elsewhere = query_of(RIGS["panorama"][0], Hints(position_m=(4.3, 0.7, 1.4), radius_m=0.5))
    assert poses_of_prior(elsewhere, known(expected(POSE).prior)) == []


@pytest.mark.slow
def test_a_prior_does_not_choose_between_places_that_look_the_same() -> None:
    found = localized(SYMMETRIC.panorama(POSE), SYMMETRIC, hints=expected(POSE))
    assert (found.status, [remark.reason for remark in found.warnings]) == ("ambiguous", ["places_look_alike"])


@pytest.mark.slow
def test_a_prior_makes_nothing_of_a_panorama_of_another_place() -> None:
    found = localized(OTHER_BOX.panorama(POSE), hints=expected(POSE))
    assert found.status == "not_localized"
    assert not any("hints" in warning for warning in found.warnings)


@pytest.mark.slow
def test_the_prior_of_a_session_is_of_its_first_image() -> None:
    first = MAP_FROM_SESSION.after(FOUR[0])
    found = localized(session_of(FOUR), hints=expected(moved(first, (0.1, 0.1, 0.0), 3.0)))
    assert (found.status, found.search.num_starts) == ("localized", 0)
    assert_found(found, first)


@pytest.mark.slow
def test_a_prior_that_the_hints_exclude_is_not_looked_at() -> None:
    hints = replace(expected(POSE), position_m=(4.3, 0.7, 1.4), radius_m=0.5)
    assert localized(panorama(), hints=hints).status == "not_localized"
