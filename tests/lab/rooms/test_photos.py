"""Photos of scenes: pixels and rays agree, and cameras are where their recipes say."""

import numpy as np
import pytest

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.lens import project_to_image
from panoloc.core.camera.rig import Photo
from panoloc.core.geometry.pose import Pose, pose_error
from panoloc.lab.rooms import (
    CAMERAS,
    Scene,
    sample_pose,
    scan_with_truth,
    suite_cases,
    take_photo,
)
from panoloc.lab.rooms.capture.camera_look import PHOTO, looked
from panoloc.lab.rooms.capture.shooting import session_axes, tracked

LENSES = {
    "pinhole": Camera.from_hfov("pinhole", 160, 120, 69.0),
    "distorted": Camera("opencv", 160, 120, 118.0, 117.0, 81.0, 59.0, (0.11, -0.23, 0.0012, -0.0007)),
    "fisheye": Camera("opencv_fisheye", 100, 100, 14.0, 14.0, 50.0, 50.0),  # does not fill the corners
    "cylinder": Camera.from_hfov("cylindrical", 240, 50, 270.0),
}


@pytest.mark.parametrize("name", LENSES)
def test_what_a_ray_hit_is_projected_to_the_pixel_of_that_ray(room: Scene, pose: Pose, name: str) -> None:
    camera = LENSES[name]
    view = take_photo(room, camera, pose)
    seen = view.hits.found & view.photo.valid.ravel()
    points = view.pose.position + view.directions * np.where(seen, view.hits.distance, 1.0)[:, None]
    u, v, shown = project_to_image(camera, (points - pose.position) @ pose.rotation)
    row, column = np.divmod(np.arange(len(points)), camera.width_px)
    assert seen.mean() > 0.55
    assert shown[seen].all()
    assert (view.photo.color[~view.photo.valid] == 0).all()
    np.testing.assert_allclose(u[seen], column[seen] + 0.5, atol=1e-3)
    np.testing.assert_allclose(v[seen], row[seen] + 0.5, atol=1e-3)


def test_a_photo_shows_the_colors_of_the_scan_where_its_pose_projects_the_points(room: Scene, pose: Pose) -> None:
    camera = Camera.from_hfov("pinhole", 320, 240, 69.0)
    view, scan = take_photo(room, camera, pose), scan_with_truth(room, num_points=40_000)
    toward = scan.exact_positions - pose.position
    u, v, shown = project_to_image(camera, toward @ pose.rotation)
    row, column = v[shown].astype(int).clip(0, 239), u[shown].astype(int).clip(0, 319)
    near = np.abs(view.hits.distance.reshape(240, 320)[row, column] - np.linalg.norm(toward[shown], axis=1)) < 0.03
    difference = np.abs(view.photo.color[row, column].astype(float) - scan.cloud.colors[shown])[near].mean(1)
    assert near.sum() > 500
    assert np.median(difference) < 6


def test_the_blur_of_a_photo_does_not_reach_around_to_the_other_side() -> None:
    halves = np.zeros((8, 64, 3), np.uint8)
    halves[:, 32:] = 255
    photo = looked(halves, PHOTO, (1,), "edge")
    around = looked(halves, PHOTO, (1,), "wrap")
    assert int(photo[:, 0].mean()) < int(around[:, 0].mean())


@pytest.fixture(scope="module")
def room_cases(room: Scene) -> dict[str, list[list[Pose]]]:
    """Return the poses of ten queries of every camera in one room."""
    return {
        name: [camera.shooting.poses(room, np.random.default_rng(seed)) for seed in range(10)]
        for name, camera in CAMERAS.items()
        if camera.shooting is not None
    }


def angles(pose: Pose) -> np.ndarray:
    return np.degrees(pose.yaw_pitch_roll)


@pytest.mark.parametrize(
    ("name", "pitch", "roll"), [("photo", 5, 5), ("sweep", 3, 3), ("frames4", 8, 5), ("photo_free", 60, 180)]
)
def test_cameras_are_held_as_level_as_their_recipe_says(
    room_cases: dict[str, list[list[Pose]]], name: str, pitch: float, roll: float
) -> None:
    held = np.abs([angles(pose)[1:] for poses in room_cases[name] for pose in poses])
    assert (held <= (pitch + 1e-6, roll + 1e-6)).all()
    assert (held.max(0) > (pitch / 3, roll / 3)).all()


def test_a_zoom_is_in_the_photo_and_not_in_what_is_stated_of_its_camera() -> None:
    camera = Camera("pinhole", 64, 48, 50.0, 50.0, 32.0, 24.0)
    photo = Photo(np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), bool), camera)
    for seed in range(20):
        rig, _ = CAMERAS["photo_zoom"].rig_of([photo], [Pose(np.eye(3), np.zeros(3))], np.random.default_rng(seed))
        (stated,) = rig.photos
        assert 1.2 <= camera.fx_px / stated.camera.fx_px <= 2.0
        assert stated.color is photo.color
        assert stated.focal_uncertainty > 0
    assert CAMERAS["photo"].rig_of([photo], [Pose(np.eye(3), np.zeros(3))], np.random.default_rng(0))[0].photos == (
        photo,
    )


@pytest.mark.parametrize(("name", "apart", "count"), [("frames2", 90, 2), ("frames4", 60, 4), ("frames6", 60, 6)])
def test_frames_turn_by_their_angle_about_a_body_at_arms_length(
    room_cases: dict[str, list[list[Pose]]], name: str, apart: float, count: int
) -> None:
    for poses in room_cases[name]:
        assert len(poses) == count
        headings = np.array([angles(pose)[0] for pose in poses])
        steps = (np.diff(headings) + 180) % 360 - 180
        np.testing.assert_allclose(steps, apart, atol=10.001)
        # Going back by the arm along the horizontal view meets the body, for one arm of all.
        looks = np.array([pose.rotation[:2, 0] / np.linalg.norm(pose.rotation[:2, 0]) for pose in poses])
        centers = np.array([pose.position for pose in poses])
        arms = np.linspace(0.2, 0.8, 61)
        spread = [np.ptp(centers[:, :2] - arm * looks, axis=0).max() for arm in arms]
        assert min(spread) < 0.17
        assert 0.25 < arms[int(np.argmin(spread))] < 0.75
        assert np.ptp(centers[:, 2]) <= 0.06 + 1e-9


def test_no_camera_stands_in_furniture(room: Scene, room_cases: dict[str, list[list[Pose]]]) -> None:
    centers = np.array([pose.position for many in room_cases.values() for poses in many for pose in poses])
    assert room.surface.clearance(centers).min() >= 0.2 - 1e-6


def test_a_sweep_is_fifty_degrees_high_however_wide_it_is() -> None:
    for seed in range(5):
        sweep = CAMERAS["sweep"].shooting
        assert sweep is not None
        camera = sweep.camera(np.random.default_rng(seed), 1024)
        assert 180 <= camera.hfov_deg <= 360
        assert np.degrees(2 * np.arctan(camera.height_px / 2 / camera.fy_px)) == pytest.approx(50, abs=0.3)


def test_tracking_noise_is_as_large_as_it_is_said_to_be(room: Scene) -> None:
    photo = take_photo(room, Camera.from_hfov("pinhole", 8, 6, 69.0), Pose(np.eye(3), np.array([0, 0, 1.5]))).photo
    rng = np.random.default_rng(3)
    true = [sample_pose(room, rng, "any") for _ in range(400)]
    axes = session_axes(rng, true[0], upright=True)
    options = CAMERAS["frames2"].session
    assert options is not None
    session = tracked([photo] * 400, true, axes, options, rng)
    errors = [
        pose_error(axes.after(image.session_from_camera), pose)
        for image, pose in zip(session.images, true, strict=True)
    ]
    assert np.sqrt(np.mean([error.position_m**2 for error in errors])) == pytest.approx(0.01, rel=0.1)
    assert np.sqrt(np.mean([error.orientation_deg**2 for error in errors])) == pytest.approx(0.5, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["rooms/photo", "changed/frames2", "survey/frames2_free", "labels/fisheye", "night/sweep"]
)
def test_the_poses_of_a_case_are_those_of_its_session_but_for_the_noise(name: str) -> None:
    case = next(suite_cases(name, [5], width=64, num_points=4000))
    assert case.map_from_session is not None
    assert case.pose is case.image_poses[0] or name.startswith("survey")
    noisy = "frames" in name
    for image, pose in zip(case.query.images, case.image_poses, strict=True):
        found = case.map_from_session.after(image.session_from_camera)
        assert pose_error(found, pose).within(0.05 if noisy else 1e-9, 2.5 if noisy else 1e-5)
        assert (found.position != pose.position).any() == noisy
        low, high = case.cloud.bounds
        assert (low <= pose.position - case.cloud.origin_offset).all()
        assert (pose.position - case.cloud.origin_offset <= high).all()
