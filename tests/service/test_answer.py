"""The answer to a query, from a made-up result of the search."""

import json
import math
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from pyproj import Proj, Transformer

from panoloc.core.camera.camera import Camera
from panoloc.core.camera.rig import Panorama, Photo, Rig, RigImage
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Frame, Status, TrackedPose
from panoloc.core.remarks import Remark
from panoloc.core.results import Candidate, Evidence, FoundImage, Localization, SearchSummary
from panoloc.service.jobs import LocalizeJob, MapRef, QueryImage, QueryOptions
from panoloc.service.worker.answers import answer_of
from tests.core.exports.tours import GOLDEN
from tests.core.painted_box import rotation_of

PANORAMA = Rig.of_panorama(Panorama(np.zeros((64, 128, 3), np.uint8), np.ones((64, 128), bool)))
MAPS = (MapRef("map_a", 1), MapRef("map_b", 7))


def candidate(map_position: int = 0, confidence: float = 0.9) -> Candidate:
    return Candidate(
        pose=Pose(rotation_of(90), np.array([1.0, 2.0, 3.0])),
        map_position=map_position,
        confidence=confidence,
        score=5.0,
        sampling_loss=0.11,
        color_model="none",
        num_iterations=60,
    )


def localization(status: Status = "localized", best: Candidate | None = None) -> Localization:
    return Localization(
        status=status,
        best=best or candidate(),
        alternatives=(candidate(map_position=1, confidence=0.04),),
        accuracy_position_m=0.02,
        accuracy_orientation_deg=0.3,
        panorama_changed_fraction=0.18,
        map_changed_fraction=np.float32(0.25),  # type: ignore[arg-type]
        timings_s={"search": 0.06, "refine": 0.4},
        search=SearchSummary("fast", 2, np.int64(412), 2304, 900_000),  # type: ignore[arg-type]
        evidence=Evidence({"correlation": math.nan, "coverage": 0.9}, {"margin": 0.5}, (0.2,), None, (0.004, 0.1)),
        warnings=(Remark("check_image", "dark image"),),
    )


def body_of(
    found: Localization,
    frame: Frame = "ros",
    query: Rig = PANORAMA,
    georeferences: dict[str, dict[str, Any]] | None = None,
    pose: TrackedPose | None = None,
) -> dict[str, Any]:
    images = tuple(QueryImage(b"", session_from_camera=pose) for _ in query.images)
    job = LocalizeJob("loc_1", "req_1", images, MAPS, QueryOptions(30, frame=frame), 0.0, georeferences or {})
    answer = answer_of(found, job, query.photos, {"decode": 0.03}, {})
    return answer.as_waited_for(0.5, [Remark("map_not_ready", "map_c is not ready")]).model_dump(mode="json")


def pose_of(pose: Pose, frame: Frame) -> dict[str, Any]:
    body = body_of(replace(localization(), best=replace(candidate(), pose=pose)), frame)
    return dict(body["pose"])


@pytest.mark.parametrize("status", ["localized", "ambiguous"])
def test_a_localized_panorama_names_its_map_and_pose(status: Status) -> None:
    body = body_of(localization(status))
    assert json.loads(json.dumps(body, allow_nan=False)) == body
    assert (body["status"], body["map_id"], body["map_revision"]) == (status, "map_a", 1)
    assert body["pose"]["map_from_camera"]["position_m"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    assert body["confidence"] == 0.9
    assert body["accuracy"] == {"position_m": 0.02, "orientation_deg": 0.3, "level": 0.68}
    assert body["change"] == {"panorama_changed_fraction": 0.18, "map_changed_fraction": 0.25}
    assert body["timings_s"] == {"queue": 0.01, "decode": 0.03, "search": 0.06, "refine": 0.4, "total": 0.5}
    assert body["warnings"] == ["dark image", "map_c is not ready"]
    assert body["reasons"] == ["check_image", "map_not_ready"]
    assert [(each["map_id"], each["confidence"]) for each in body["alternatives"]] == [("map_b", 0.04)]


def test_the_search_of_an_answer_has_the_figures_of_the_search_the_best_pose_and_its_evidence() -> None:
    assert body_of(localization())["search"] == {
        "method": "fast",
        "num_maps": 2,
        "num_starts": 412,
        "num_rotations": 2304,
        "num_poses": 900_000,
        "color_model": "none",
        "sampling_loss": 0.11,
        "score": 5.0,
        "iterations": 60,
        "num_iterations": 60,
        "measures": {"correlation": None, "coverage": 0.9},
        "features": {"margin": 0.5},
        "alias_margins": [0.2],
        "runner_up_score": None,
        "formal_radii": [0.004, 0.1],
    }


def test_without_a_fitting_pose_the_best_guess_is_the_first_alternative() -> None:
    body = body_of(localization("not_localized", candidate(confidence=0.2)))
    assert body["pose"] is None
    assert body["map_id"] is None
    assert body["accuracy"] is None
    assert body["confidence"] == 0.2
    assert [alternative["confidence"] for alternative in body["alternatives"]] == [0.2, 0.04]


def test_when_nothing_could_be_searched_the_answer_is_empty_but_complete() -> None:
    nothing = replace(
        localization("not_localized"), best=None, evidence=None, alternatives=(), accuracy_position_m=None
    )
    body = body_of(nothing)
    assert body["pose"] is None
    assert body["alternatives"] == []
    assert set(body["search"]) == {"method", "num_maps", "num_starts", "num_rotations", "num_poses"}
    assert body["confidence"] == 0.0


@pytest.mark.parametrize("frame", get_args(Frame))
def test_the_golden_pose_has_its_golden_angles_in_every_frame(frame: Frame) -> None:
    pose = pose_of(GOLDEN, frame)
    angles = [pose[name] for name in ("yaw_deg", "pitch_deg", "roll_deg")]
    assert angles == pytest.approx([52.5, 12.25, 4.75], abs=1e-6)
    angles = [pose[name] for name in ("heading_deg", "elevation_deg", "camera_roll_deg")]
    assert angles == pytest.approx([37.5, -12.25, 4.75], abs=1e-6)
    assert pose["north"] == "map"


def test_a_heading_counts_clockwise_from_y_through_a_whole_turn() -> None:
    yaws = {0: 90, 90: 0, 89: 1, 91: 359, 180: 270, -180: 270, -90: 180, 90 - 1e-13: 0}
    for yaw_deg, heading_deg in yaws.items():
        pose = pose_of(Pose(rotation_of(yaw_deg), np.zeros(3)), "ros")
        assert pose["heading_deg"] == pytest.approx(heading_deg, abs=1e-9), yaw_deg
        assert 0 <= pose["heading_deg"] < 360


def test_a_camera_that_looks_up_has_a_positive_elevation_and_one_whose_right_side_is_down_a_positive_roll() -> None:
    up = pose_of(Pose(np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]), np.zeros(3)), "ros")
    assert up["elevation_deg"] == pytest.approx(90)
    s = math.sqrt(0.5)
    right_down = Pose(np.array([[1, 0, 0], [0, s, -s], [0, s, s]]), np.zeros(3))
    assert (right_down.rotation @ [0, -1, 0])[2] < 0
    assert pose_of(right_down, "ros")["camera_roll_deg"] == pytest.approx(45)


PLACE = {"latitude_deg": 47.7, "longitude_deg": -122.3, "height_m": 11.5}


def test_a_heading_counts_from_true_north_where_the_map_has_a_georeference() -> None:
    both = replace(localization(), best=replace(candidate(), pose=GOLDEN))
    body = body_of(both, georeferences={"map_a": {**PLACE, "heading_deg": -40.0}})
    assert (body["pose"]["heading_deg"], body["pose"]["north"]) == (pytest.approx(357.5, abs=1e-6), "true")
    assert body["images"][0]["pose"] == body["pose"]
    assert body["alternatives"][0]["map_id"] == "map_b"
    assert body["alternatives"][0]["pose"]["north"] == "map"


@pytest.mark.parametrize("frame", get_args(Frame))
def test_a_heading_in_a_grid_is_turned_by_the_convergence_that_pyproj_gives_at_the_very_place(frame: Frame) -> None:
    """A camera in UTM zone 32 that looks along the grid's north, at the ends of a map a kilometre long."""
    convergences = []
    for east in (640_000.0, 641_000.0):
        pose = Pose(rotation_of(90), np.array([east, 5_320_000.0, 512.0]))
        both = replace(localization(), best=replace(candidate(), pose=pose))
        body = body_of(both, frame, georeferences={"map_a": {"coordinate_system": "EPSG:25832"}})["pose"]
        longitude, latitude = Transformer.from_crs(25832, 4326, always_xy=True).transform(east, 5_320_000.0)
        convergences.append(Proj(25832).get_factors(longitude, latitude).meridian_convergence)
        assert body["north"] == "true"
        assert body["heading_deg"] == pytest.approx(convergences[-1], abs=0.001)
    assert convergences[1] - convergences[0] > 0.009  # one convergence for the whole map would be wrong


def test_a_pose_outside_of_its_coordinate_system_has_the_north_of_its_map() -> None:
    far = Pose(rotation_of(90), np.array([1e12, 1e12, 0.0]))
    both = replace(localization(), best=replace(candidate(), pose=far))
    body = body_of(both, georeferences={"map_a": {"coordinate_system": "EPSG:25832"}})["pose"]
    assert (body["heading_deg"], body["north"]) == (pytest.approx(0.0), "map")


LENS = Camera.from_hfov("pinhole", 64, 48, 69.0)
PHOTO = Photo(np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), bool), LENS)
FRAMES: tuple[Frame, ...] = get_args(Frame)


def session_of(*poses: Pose) -> Rig:
    return Rig(tuple(RigImage(PHOTO, pose) for pose in poses))


def found_session(session: Rig, map_from_session: Pose, status: Status = "localized") -> Localization:
    poses = [map_from_session.after(image.session_from_camera) for image in session.images]
    images = tuple(FoundImage(pose, 0.5 + 0.1 * number) for number, pose in enumerate(poses))
    best = replace(candidate(), pose=poses[0])
    return replace(localization(status, best), map_from_session=map_from_session, images=images)


def matrix_in(motion: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return a motion of an answer (4, 4), its parts held against each other."""
    matrix = np.array(motion["matrix"])
    assert matrix[3].tolist() == [0, 0, 0, 1]
    assert matrix[:3, 3].tolist() == list(motion["position_m"].values())
    quaternion = list(motion["quaternion"].values())
    assert np.allclose(Pose.from_frame((0, 0, 0), quaternion, "ros").rotation, matrix[:3, :3])
    return matrix


@pytest.mark.parametrize("frame", FRAMES)
def test_in_the_axes_of_every_frame_an_image_is_at_map_from_session_after_its_own_pose(frame: Frame) -> None:
    poses = Pose(rotation_of(10), np.array([0.1, 0.2, 0.3])), Pose(rotation_of(70), np.array([0.4, -0.2, 0.1]))
    session = session_of(*poses)
    found = found_session(session, Pose(rotation_of(30), np.array([4.0, 5.0, 6.0])))
    body = body_of(found, frame, session, pose=TrackedPose())
    map_from_session = matrix_in(body["map_from_session"])
    for image, pose in zip(body["images"], poses, strict=True):
        assert image["pose"]["frame"] == frame
        sent = pose.in_frame(frame).matrix
        np.testing.assert_allclose(matrix_in(image["pose"]["map_from_camera"]), map_from_session @ sent, atol=1e-9)
    assert body["images"][0]["pose"] == body["pose"]
    assert [image["agreement"] for image in body["images"]] == [0.5, 0.6]
    assert body["images"][1]["camera"] == {"model": "pinhole", "hfov_deg": 69.0}


@pytest.mark.parametrize("frame", FRAMES)
def test_the_session_of_one_camera_without_a_pose_is_that_camera(frame: Frame) -> None:
    photo = replace(localization(), map_from_session=candidate().pose, images=(FoundImage(candidate().pose, 0.6),))
    for found, query, hfov_deg in ((photo, Rig.of_photo(PHOTO), 69.0), (localization(), PANORAMA, 360.0)):
        body = body_of(found, frame, query)
        assert body["map_from_session"] == body["pose"]["map_from_camera"]
        (image,) = body["images"]
        assert image["pose"] == body["pose"]
        assert image["camera"]["hfov_deg"] == hfov_deg


def test_a_single_image_agrees_as_the_whole_query_does() -> None:
    found = replace(localization(), evidence=Evidence({"correlation": 0.83}, {}, (), None, None))
    assert body_of(found)["images"][0]["agreement"] == 0.83
    assert body_of(localization())["images"][0]["agreement"] is None


def test_a_session_that_fits_nowhere_has_no_poses_but_says_how_its_images_agreed() -> None:
    session = session_of(Pose(np.eye(3), np.zeros(3)), Pose(rotation_of(70), np.zeros(3)))
    body = body_of(found_session(session, candidate().pose, "not_localized"), query=session, pose=TrackedPose())
    assert body["map_from_session"] is None
    assert [image["pose"] for image in body["images"]] == [None, None]
    assert [image["agreement"] for image in body["images"]] == [0.5, 0.6]
    nothing = Localization("not_localized", localization().search, {})
    assert [image["agreement"] for image in body_of(nothing, query=session, pose=TrackedPose())["images"]] == [
        None,
        None,
    ]
