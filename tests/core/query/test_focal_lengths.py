"""Focal lengths that are not known for certain: what is known before the search, what is tried, and what is found."""

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from panoloc.core.camera.camera import Camera, CameraModel
from panoloc.core.camera.rig import Photo, Rig, RigImage
from panoloc.core.config import FocalConfig
from panoloc.core.decide.hypotheses import Hypothesis
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.core.image.photo_window import shown_share
from panoloc.core.query.engine import Engine
from panoloc.core.query.focal_lengths import (
    FocalPrior,
    contradicts,
    focal_prior,
    focal_uncertainty,
    found_cameras,
    guesses,
    with_other_focal_lengths,
)
from panoloc.core.query.map_query import PreparedRig, prepare_queries
from panoloc.core.render.synthetic_view import RENDER_BATCH
from tests.core.built_maps import AS_LABELS, BOX, LABELLED, POSE, SYMMETRIC, TWIN, localized, map_of, panorama, rig_of
from tests.core.found_pose import assert_found, best_of, known
from tests.core.image.painted_photos import photo_of
from tests.core.painted_box import PaintedBox, rotation_of
from tests.core.search.found_candidates import CONFIG

FOCAL = FocalConfig()
WIDTH_DEG = 84.0
TAKEN = Camera.from_hfov("pinhole", 640, 480, WIDTH_DEG)
ROUNDED = 0.006  # share of the focal length that is lost where degrees are whole


def said_to_be(photo: Photo, hfov_deg: float, uncertainty: float = ROUNDED) -> Photo:
    camera = Camera.from_hfov("pinhole", photo.camera.width_px, photo.camera.height_px, hfov_deg)
    return replace(photo, camera=camera, focal_uncertainty=uncertainty)


def zoomed(uncertainty: float = ROUNDED) -> Photo:
    """Return a photo 84 degrees wide, said to be 100: by a focal length too short by a factor of 1.32."""
    return said_to_be(photo_of(TAKEN), 100.0, uncertainty)


def of_unknown_field_of_view(bounds_deg: tuple[float, float], box: PaintedBox = BOX) -> Photo:
    """Return a photo 84 degrees wide, taken for one of 70."""
    return replace(said_to_be(photo_of(TAKEN, POSE, box), 70.0, 0.0), hfov_range_deg=bounds_deg)


def hypothesis(log_focal: float | None) -> Hypothesis:
    return Hypothesis(0, 0, torch.eye(3), torch.zeros(3), log_focal=log_focal)


def logs(found: Sequence[Hypothesis]) -> list[float]:
    return [known(h.log_focal) for h in found]


# What is known before the search.


def test_what_is_known_are_bounds_or_a_statement_or_all_of_it() -> None:
    def prior_of(photo: Photo) -> FocalPrior | None:
        return focal_prior(Rig.of_photo(photo), FOCAL)

    assert prior_of(zoomed(0.0)) == FocalPrior(*FOCAL.bounds, is_stated=True, is_measured=True)
    assert focal_prior(rig_of(panorama()), FOCAL) is None
    assert prior_of(zoomed()) == FocalPrior(*FOCAL.bounds, is_stated=True)
    bounds = known(prior_of(of_unknown_field_of_view((60.0, 90.0))))
    # Half the width over the focal length is the tangent of half the angle.
    assert not bounds.is_stated
    for log, width_deg in ((bounds.least, 90.0), (bounds.most, 60.0)):
        assert math.exp(log) == pytest.approx(math.tan(math.radians(35)) / math.tan(math.radians(width_deg / 2)))


@pytest.mark.parametrize("other", [(60.0, 90.0), None])
def test_photos_of_several_cameras_are_not_searched_together(other: tuple[float, float] | None) -> None:
    photos = (
        of_unknown_field_of_view((60.0, 100.0)),
        replace(of_unknown_field_of_view((60.0, 100.0)), hfov_range_deg=other),
    )
    with pytest.raises(OptionsError, match="hfov_range_deg: expected the same bounds for all images"):
        focal_prior(Rig(tuple(RigImage(photo, Pose(np.eye(3), np.zeros(3))) for photo in photos)), FOCAL)


@pytest.mark.parametrize("bounds_deg", [(70.0, 71.0), (60.0, 90.0), (45.0, 100.0)])
def test_no_focal_length_within_bounds_is_farther_from_a_guess_than_half_a_step(
    bounds_deg: tuple[float, float],
) -> None:
    rig = Rig.of_photo(of_unknown_field_of_view(bounds_deg))
    guessed = [each.photos[0].camera.fx_px for each in guesses(rig, FOCAL)]
    for width_deg in np.linspace(*bounds_deg, 50):
        focal_px = Camera.from_hfov("pinhole", 640, 480, width_deg).fx_px
        assert min(abs(math.log(each / focal_px)) for each in guessed) <= FOCAL.step / 2 + 1e-6
    stated = Rig.of_photo(zoomed())
    assert guesses(stated, FOCAL) == [stated]


def of_panorama(model: CameraModel, width_px: int, height_px: int, hfov_deg: float) -> Rig:
    """Return an image without a focal length, of which a field of view is all that is known."""
    blank, camera = np.zeros((height_px, width_px, 3), np.uint8), Camera.from_hfov(model, width_px, height_px, hfov_deg)
    return Rig.of_photo(Photo(blank, np.ones(blank.shape[:2], bool), camera, focal_uncertainty=ROUNDED))


@pytest.mark.parametrize("rows", [100, 150, 250])
def test_no_horizon_of_a_strip_is_farther_from_a_guess_than_half_a_step(rows: int) -> None:
    strip = of_panorama("equirectangular", 512, rows, 360.0)
    first, *_ = rigs = guesses(strip, FOCAL)
    assert first is strip
    angles = sorted((each.photos[0].camera.cy_px - rows / 2) * math.pi / 256 for each in rigs)
    cut_on_one_side = (256 - rows) / 2 * math.pi / 256
    assert [angles[0], angles[-1]] == pytest.approx([-cut_on_one_side, cut_on_one_side])
    assert max(np.diff(angles)) <= FOCAL.step + 1e-9


def test_a_thin_strip_is_not_guessed_to_lie_farther_from_the_horizon_than_it_is_high() -> None:
    rows = [each.photos[0].camera.cy_px for each in guesses(of_panorama("equirectangular", 512, 30, 360.0), FOCAL)]
    assert [min(rows), max(rows)] == pytest.approx([-30, 60], abs=13)


def test_sweeps_are_guessed_to_be_a_step_wider_or_narrower_on_either_side_unless_that_is_more_than_all() -> None:
    step_deg = math.degrees(FOCAL.step)
    for width_deg, others in ((200.0, (-2, 2)), (350.0, (-2,))):
        first, *rest = (
            each.photos[0].camera.hfov_deg for each in guesses(of_panorama("cylindrical", 400, 100, width_deg), FOCAL)
        )
        assert first == pytest.approx(width_deg)
        assert rest == pytest.approx([width_deg + k * step_deg for k in others])


# What is tried.


def test_lengths_from_two_thirds_to_twice_the_stated_one_are_tried() -> None:
    tried = known(focal_prior(Rig.of_photo(zoomed()), FOCAL)).tried(FOCAL.step)
    assert min(tried) < math.log(0.8)
    assert max(tried) > math.log(1.9)
    assert 0.0 not in tried


def test_with_another_focal_length_the_camera_stands_where_what_is_halfway_deep_keeps_its_size() -> None:
    middle_m = 2.0
    comparison: Any = SimpleNamespace(depth_m=middle_m)
    ahead = torch.tensor([0.6, 0.8, 0.0])
    found = with_other_focal_lengths(hypothesis(0.0), comparison, FocalPrior(-0.3, 0.8, False), ahead, FOCAL)
    assert min(logs(found)) >= -0.3
    assert max(logs(found)) <= 0.8
    assert len(found) > 4
    for h, log in zip(found, logs(found), strict=True):
        behind_m = -float(h.position @ ahead)
        torch.testing.assert_close(h.position, -behind_m * ahead)
        assert math.exp(log) / (middle_m + behind_m) == pytest.approx(1 / middle_m, rel=1e-5)
    comparison.depth_m = None
    assert with_other_focal_lengths(hypothesis(0.0), comparison, FocalPrior(-0.3, 0.8, False), ahead, FOCAL) == []


def test_the_stated_focal_length_is_not_tried_again_and_one_that_is_no_likelier_than_others_is() -> None:
    comparison: Any = SimpleNamespace(depth_m=1.0)
    for is_stated in (True, False):
        prior = FocalPrior(-0.4, 0.4, is_stated)
        found = logs(with_other_focal_lengths(hypothesis(2 * FOCAL.step), comparison, prior, torch.ones(3), FOCAL))
        assert any(abs(log) < 0.01 for log in found) is not is_stated
        assert all(abs(log - 2 * FOCAL.step) > 0.01 for log in found)


def test_scores_of_focal_lengths_that_are_not_stated_or_narrow_count_less_and_shares_are_those_of_their_pixels() -> (
    None
):
    group, factors = [hypothesis(None), hypothesis(0.3), hypothesis(-0.1)], (1.0, math.exp(0.3), 1.0)
    bounds_photo = of_unknown_field_of_view((60.0, 100.0))
    stated, bounds = (
        PreparedRig(Rig.of_photo(each), None, torch.device("cpu"), CONFIG) for each in (zoomed(), bounds_photo)
    )
    assert stated.likelihoods(group).tolist() == pytest.approx([1.0, FOCAL.stated, FOCAL.stated])
    camera = bounds_photo.camera
    widest = Camera.from_hfov("pinhole", camera.width_px, camera.height_px, 100.0).solid_angle()
    less = [(camera.solid_angle(math.exp(log)) / widest) ** FOCAL.chance for log in (0.0, 0.3, -0.1)]
    assert bounds.likelihoods(group).tolist() == pytest.approx(less)
    assert less[1] < less[0] < less[2] < 1
    camera = zoomed().camera
    expected = [camera.solid_angle(factor) / (4 * math.pi) for factor in factors]
    assert stated.shares(group).tolist() == pytest.approx(expected, rel=0.02)


def test_other_extents_than_the_given_one_are_looked_at_as_closely_and_count_less_the_less_they_show() -> None:
    device, given = torch.device("cpu"), of_panorama("cylindrical", 400, 130, 200.0)
    narrow, wide = (known(given.with_other_extent(wider, 0.0)) for wider in (-0.1, 0.2))
    alone = [PreparedRig(rig, None, device, CONFIG) for rig in (narrow, given, wide)]
    prepared = [PreparedRig(rig, None, device, CONFIG, given) for rig in (narrow, given, wide)]
    assert [rig.finer for rig in alone] == [2, 2, 1]  # alone, what shows much is looked at less closely
    assert {(rig.finer, rig.rows, rig.patch_deg) for rig in prepared} == {(2, alone[1].rows, alone[1].patch_deg)}
    less = [float(rig.likelihoods([hypothesis(None)])) for rig in prepared]
    shares = [shown_share(rig) / shown_share(given) for rig in (narrow, wide)]
    assert less[1] == 1.0
    assert [less[0], less[2]] == pytest.approx([FOCAL.stated * share**FOCAL.chance for share in shares])
    assert less[0] < FOCAL.stated < less[2]


class _Contest:
    """Stands in for the contest of a sweep: the nearer its width is to 213 degrees, the better all poses fit."""

    def __init__(self, rig: Rig) -> None:
        self.rig, self.hypotheses, self.taken = rig, [], []  # type: ignore[var-annotated]

    def add(self, proposed: Sequence[Hypothesis]) -> None:
        self.taken += proposed
        self.hypotheses = [replace(each, score=-abs(self.rig.photos[0].camera.hfov_deg - 213.0)) for each in self.taken]


def test_the_extent_comes_as_near_as_a_pixel_and_poses_elsewhere_stay_rivals() -> None:
    given = of_panorama("cylindrical", 400, 130, 200.0)
    engine, guess = Engine(CONFIG, Any), _Contest(given)  # type: ignore[arg-type]  # asked for no confidence
    guess.add([hypothesis(None), replace(hypothesis(None), start=7)])
    found: Any = engine._closer(given, guess, _Contest)  # type: ignore[arg-type]
    pixel_deg = 180 / (2 * CONFIG.refinement.fine_rows)
    assert found.rig.photos[0].camera.hfov_deg == pytest.approx(213.0, abs=2 * pixel_deg)
    assert [each.start for each in found.taken[1:]] == [guess.taken[0].start, 7]
    best = _Contest(found.rig)
    best.add(guess.taken)
    assert engine._closer(found.rig, best, _Contest) is best  # type: ignore[arg-type,comparison-overlap]
    assert best.taken == guess.taken


# What is found.


def test_a_pose_with_another_focal_length_is_judged_as_if_it_was_stated() -> None:
    """The right pose of a zoomed photo has to win against those that a wrong focal length makes seem right."""
    index = map_of(BOX)
    factor = TAKEN.fx_px / zoomed().camera.fx_px
    (unsure,) = prepare_queries(Rig.of_photo(zoomed()), [index], None, CONFIG)
    (told,) = prepare_queries(Rig.of_photo(photo_of(TAKEN)), [index], None, CONFIG)
    at = torch.tensor(POSE.rotation).float(), torch.tensor(POSE.position - index.origin_offset).float()
    found, _ = unsure.judge_alone(Hypothesis(0, 0, *at, log_focal=math.log(factor)))
    exact, _ = told.judge_alone(Hypothesis(0, 0, *at))
    assert found.score == pytest.approx(FOCAL.stated * exact.score, rel=0.1)  # its edges are taken to be as stated


def test_poses_that_are_judged_together_have_the_scores_that_they_have_alone() -> None:
    index = map_of(BOX)
    (query,) = prepare_queries(Rig.of_photo(zoomed()), [index], None, CONFIG)
    rotation = torch.tensor(POSE.rotation).float()
    middle = torch.tensor(POSE.position - index.origin_offset).float()
    group = [
        Hypothesis(0, 0, rotation, middle + 0.05 * k, log_focal=(None, 0.1, 0.3)[k % 3])
        for k in range(RENDER_BATCH + 2)
    ]
    alone = [judged.score for each in group for judged in query.judge([each])]
    assert [each.score for each in query.judge(group)] == pytest.approx(alone, rel=1e-3)


def test_the_cameras_of_an_answer_are_those_of_its_best_pose() -> None:
    stated = Rig.of_photo(zoomed())
    assert found_cameras(stated, stated, [], FOCAL).rig is stated
    as_given = found_cameras(stated, stated, [hypothesis(None), hypothesis(0.3)], FOCAL)
    assert (as_given.rig, as_given.are_others, as_given.warnings) == (stated, False, ())
    log = math.log(TAKEN.fx_px / stated.photos[0].camera.fx_px)
    other = found_cameras(stated, stated, [hypothesis(log), hypothesis(0.0)], FOCAL)
    assert other.are_others
    assert other.rig.photos[0].camera.fx_px == pytest.approx(TAKEN.fx_px)
    assert "84.0 degrees wide, not 100.0 as given" in other.warnings[0]
    assert "session_from_camera" not in other.warnings[0]
    two = replace(stated, images=2 * stated.images)  # what seems another lens may be another unit of the poses
    assert "session_from_camera" in found_cameras(two, two, [hypothesis(log)], FOCAL).warnings[0]
    nearly = found_cameras(stated, stated, [hypothesis(0.07)], FOCAL)
    assert (nearly.are_others, nearly.warnings) == (True, ())


def test_the_extent_that_was_found_is_that_of_the_answer_and_a_width_that_differs_much_is_told() -> None:
    sweep, strip = of_panorama("cylindrical", 400, 100, 220.0), of_panorama("equirectangular", 512, 150, 360.0)
    for given, wider, higher, words in (
        (sweep, -0.2, 0.1, "197.1 degrees wide, not 220.0"),
        (sweep, -0.1, 0.0, ""),
        (strip, 0.0, 0.3, ""),
    ):
        other = known(given.with_other_extent(wider, higher))
        found = found_cameras(given, other, [hypothesis(None)], FOCAL)
        assert (found.rig, found.are_others, len(found.warnings)) == (other, True, bool(words))
        assert all(words in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("range_deg", "bound_deg"), [((60.0, 84.05), 84.05), ((83.95, 90.0), 83.95), ((60.0, 90.0), None)]
)
def test_a_field_of_view_at_a_bound_is_told_and_one_between_needs_no_warning(
    range_deg: tuple[float, float], bound_deg: float | None
) -> None:
    given = Rig.of_photo(of_unknown_field_of_view(range_deg))
    searched = given.with_focal_factor(0.9)
    log = math.log(TAKEN.fx_px / searched.photos[0].camera.fx_px)
    found = found_cameras(given, searched, [hypothesis(log)], FOCAL)
    assert (found.are_others, found.warnings, found.bound_deg) == (True, (), bound_deg)


@pytest.mark.parametrize(
    ("log_focal", "score", "is_other"),
    [(0.25, 1.0, True), (-0.25, 0.91, True), (-0.25, 0.89, False), (0.15, 1.0, False), (0.45, 1.0, True)],
)
def test_what_is_stated_is_contradicted_beyond_chance_by_what_fits_hardly_worse(
    log_focal: float, score: float, is_other: bool
) -> None:
    other = replace(hypothesis(log_focal), score=score, information=2.0)  # certain to 5 %
    best, stated = replace(hypothesis(None), score=1.0), FocalPrior(*FOCAL.bounds, is_stated=True)
    assert contradicts(other, best, stated, FOCAL) == is_other
    assert not contradicts(replace(other, information=0.1), best, stated, FOCAL)


def test_images_that_tell_nothing_leave_a_focal_length_entirely_open() -> None:
    assert focal_uncertainty(0.0, FOCAL) == 1.0
    assert focal_uncertainty(25.0, FOCAL) == pytest.approx(FOCAL.noise / 5)


@pytest.mark.parametrize(("log_focal", "is_other"), [(0.07, False), (-0.07, False), (0.08, True), (-0.08, True)])
def test_a_measured_focal_length_is_not_wrong_by_a_few_percent(log_focal: float, is_other: bool) -> None:
    sharp, best = replace(hypothesis(log_focal), score=1.0, information=100.0), replace(hypothesis(None), score=1.0)
    for is_measured in (True, False):
        prior = FocalPrior(*FOCAL.bounds, True, is_measured)
        assert contradicts(sharp, best, prior, FOCAL) == (is_other or not is_measured)


# Photos in a box.


@pytest.mark.slow
def test_a_photo_of_a_zoom_is_found_where_it_was_taken_and_the_answer_says_how_wide_it_is() -> None:
    found = localized(zoomed())
    assert found.status == "localized"
    # Two and a half degrees more are a focal length 4 % shorter, and as much nearer to walls that are two metres away.
    assert_found(found, POSE, 0.1)
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=2.5)
    (words,) = found.warnings
    assert "not 100.0 as given" in words
    assert "hfov_deg" in words


@pytest.mark.slow
def test_one_that_is_said_to_be_far_too_narrow_fits_best_where_it_was_taken() -> None:
    found = localized(said_to_be(photo_of(TAKEN), 60.0))
    assert_found(found, POSE, 0.1)
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([WIDTH_DEG], abs=4.0)


@pytest.mark.slow
def test_measured_intrinsics_that_are_wrong_are_contradicted() -> None:
    found = localized(zoomed(0.0))
    assert_found(found, POSE, 0.1)
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([WIDTH_DEG], abs=2.5)
    assert [warning.reason for warning in found.warnings] == ["hfov_contradicted"]


@pytest.mark.slow
@pytest.mark.parametrize(("hfov_deg", "uncertainty"), [(70.0, ROUNDED), (84.0, ROUNDED), (100.0, ROUNDED), (84.0, 0.0)])
def test_one_that_is_as_wide_as_it_is_said_to_be_is_left_alone(hfov_deg: float, uncertainty: float) -> None:
    found = localized(said_to_be(photo_of(Camera.from_hfov("pinhole", 640, 480, hfov_deg)), hfov_deg, uncertainty))
    assert (found.found_cameras, found.warnings) == ((), ())
    assert_found(found, POSE)


@pytest.mark.slow
def test_a_room_that_looks_the_same_from_two_sides_tells_it_as_well() -> None:
    found = localized(said_to_be(photo_of(TAKEN, POSE, SYMMETRIC), 100.0), SYMMETRIC, top_k=2)
    assert found.status == "ambiguous"
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([WIDTH_DEG], abs=4.0)
    best = best_of(found).pose
    assert any(pose_error(best, side).within(0.15, 5.0) for side in (POSE, TWIN))


@pytest.mark.slow
def test_the_images_of_a_session_say_it_too() -> None:
    camera = Camera.from_hfov("pinhole", 320, 240, 66.0)
    turns = [Pose(rotation_of(90.0 * k), np.zeros(3)) for k in range(3)]
    images = tuple(RigImage(said_to_be(photo_of(camera, POSE.after(turn)), 76.0), turn) for turn in turns)
    found = localized(Rig(images))
    assert found.status == "localized"
    assert_found(found, POSE)
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([66.0] * 3, abs=2.0)
    assert any("images of which the first is 6" in words for words in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("bounds_deg", [(70.0, 96.0), (80.0, 90.0)])
def test_a_photo_is_found_although_nobody_knows_how_wide_it_is(bounds_deg: tuple[float, float]) -> None:
    found = localized(of_unknown_field_of_view(bounds_deg))
    assert found.status == "localized"
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=2.5)
    assert_found(found, POSE, 0.15, 3.0)
    # What the focal length leaves open: some percent of the metres to the walls.
    assert known(found.accuracy_position_m) > 0.04


@pytest.mark.slow
def test_a_session_is_found_although_nobody_knows_how_wide_its_images_are() -> None:
    camera = Camera.from_hfov("pinhole", 320, 240, 66.0)
    turns = [Pose(rotation_of(90.0 * k), np.zeros(3)) for k in range(2)]
    photos = [
        replace(said_to_be(photo_of(camera, POSE.after(turn)), 70.0, 0.0), hfov_range_deg=(56.0, 84.0))
        for turn in turns
    ]
    found = localized(Rig(tuple(map(RigImage, photos, turns))))
    assert found.status == "localized"
    assert_found(found, POSE)
    assert [camera.hfov_deg for camera in found.found_cameras] == pytest.approx([66.0] * 2, abs=2.0)


@pytest.mark.slow
def test_the_boundaries_of_labels_tell_it_too() -> None:
    found = localized(of_unknown_field_of_view((74.0, 92.0), LABELLED), map_of(LABELLED, AS_LABELS))
    (camera,) = found.found_cameras
    assert camera.hfov_deg == pytest.approx(WIDTH_DEG, abs=4.0)
    assert_found(found, POSE, 0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("bounds_deg", "bound"), [((70.0, 76.0), "76"), ((92.0, 100.0), "92")])
def test_a_photo_that_is_beyond_its_bounds_is_not_localized_and_the_bound_is_named(
    bounds_deg: tuple[float, float], bound: str
) -> None:
    found = localized(of_unknown_field_of_view(bounds_deg))
    assert found.status == "not_localized"
    assert any(f"{bound} degrees wide, a bound of the range (hfov_range_deg" in words for words in found.warnings)


@pytest.mark.slow
def test_the_radius_tells_what_the_focal_length_leaves_open_and_anything_is_no_answer() -> None:
    photo = photo_of(Camera.from_hfov("pinhole", 640, 480, 100.0))
    sharp, blurred, unknown = (localized(replace(photo, focal_uncertainty=share)) for share in (0.0, 0.03, 0.3))
    radii = known(sharp.accuracy_position_m), known(blurred.accuracy_position_m)
    assert 0.5 < math.sqrt(radii[1] ** 2 - radii[0] ** 2) / 0.03 < 6  # metres to the walls of the box
    assert unknown.status == "not_localized"
    (words,) = unknown.warnings
    assert "field of view" in words
    assert "not known well enough" in words
    assert "more images" not in words
    assert "--hfov" in words
