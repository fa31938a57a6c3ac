"""Images of ROS become files that other programs read, and CameraInfo the camera that the service takes."""

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.camera.lens import project_to_image
from panoloc.core.geometry.pose import Pose as CorePose
from panoloc.ros2.images import UnusableError, camera_entry, check_image, file_of
from panoloc.ros2.poses import Pose, from_json, pose_of
from panoloc.service.http.schemas.queries import Camera, LocalizeOptions
from tests.docs.ar_devices import CX, CY, FX, FY, HEIGHT, POSITION, QUATERNION, SCAN_POINT, SEEN, WIDTH

PIXELS = np.random.default_rng(3).integers(0, 256, (5, 7, 4), np.uint8)
K = [FX, 0.0, CX - 0.5, 0.0, FY, CY - 0.5, 0.0, 0.0, 1.0]  # the centre of the first pixel is (0, 0)
UNMOVED = Pose(np.eye(3), np.zeros(3))


def image(encoding: str, order: list[int], padding: int = 0) -> SimpleNamespace:
    rows = np.pad(PIXELS[..., order].reshape(5, -1), ((0, 0), (0, padding)))
    return SimpleNamespace(encoding=encoding, height=5, width=7, step=rows.shape[1], data=rows.tobytes())


def info(**given: Any) -> SimpleNamespace:
    roi = SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)
    fields = {
        "width": WIDTH,
        "height": HEIGHT,
        "k": K,
        "p": [0.0] * 12,
        "d": [0.0] * 5,
        "distortion_model": "plumb_bob",
    }
    return SimpleNamespace(**{**fields, "binning_x": 0, "binning_y": 0, "roi": roi, **given})


@pytest.mark.parametrize(
    ("encoding", "order", "shown"),
    [
        ("rgb8", [0, 1, 2], [0, 1, 2]),
        ("bgr8", [2, 1, 0], [0, 1, 2]),
        ("rgba8", [0, 1, 2, 3], [0, 1, 2]),
        ("bgra8", [2, 1, 0, 3], [0, 1, 2]),
        ("mono8", [1], [1]),
    ],
)
def test_a_raw_image_is_the_same_in_a_png(encoding: str, order: list[int], shown: list[int]) -> None:
    message = image(encoding, order, padding=5)
    check_image(message)
    read = np.asarray(Image.open(io.BytesIO(file_of(message))))
    np.testing.assert_array_equal(read.reshape(5, 7, -1), PIXELS[..., shown])


def test_a_compressed_image_is_sent_as_it_is() -> None:
    message = SimpleNamespace(format="rgb8; jpeg compressed bgr8", data=[255, 216, 255])
    check_image(message)
    assert file_of(message) == b"\xff\xd8\xff"


@pytest.mark.parametrize(
    "message",
    [
        SimpleNamespace(encoding="bayer_rggb8"),
        SimpleNamespace(format="16UC1; compressedDepth png", data=bytes(12) + b"\x89PNG"),
        SimpleNamespace(format="theora", data=b"Ogg "),
        SimpleNamespace(encoding="rgb8", height=2, width=3, step=9, data=b"0" * 17),
        SimpleNamespace(encoding="rgb8", height=2, width=3, step=8, data=b"0" * 18),
    ],
)
def test_another_encoding_is_refused_with_what_is_expected(message: Any) -> None:
    with pytest.raises(UnusableError, match="expected"):
        check_image(message)


def test_who_sends_depth_is_told_so() -> None:
    with pytest.raises(UnusableError, match="looks like depth"):
        check_image(SimpleNamespace(encoding="16UC1"))
    with pytest.raises(UnusableError, match="image_proc"):
        check_image(SimpleNamespace(encoding="bayer_rggb8"))


@pytest.mark.parametrize(
    ("model", "distortion", "taken_for"),
    [
        ("plumb_bob", [0.1, -0.02, 0.001, 0.002, 0.01], "opencv"),
        ("rational_polynomial", [0.1] * 8, "opencv"),
        ("equidistant", [0.1] * 4, "opencv_fisheye"),
        ("equidistant", [0.0] * 4, "opencv_fisheye"),
        ("plumb_bob", [0.0] * 5, "pinhole"),
        ("plumb_bob", [], "pinhole"),
        ("", [], "pinhole"),
    ],
)
def test_the_lens_is_taken_as_its_info_says(model: str, distortion: list[float], taken_for: str) -> None:
    camera = Camera.model_validate(camera_entry(info(distortion_model=model, d=distortion), UNMOVED)).to_options()
    assert camera is not None
    assert camera.model == taken_for
    assert camera.distortion == (tuple(distortion) if any(distortion) or taken_for == "opencv_fisheye" else ())


def test_zeros_beyond_the_eight_coefficients_of_a_rational_lens_are_left_out() -> None:
    entry = camera_entry(info(distortion_model="rational_polynomial", d=[0.1] * 8 + [0.0] * 6), UNMOVED)
    assert entry["distortion"] == [0.1] * 8


def test_a_rectified_image_has_the_projection_and_no_distortion() -> None:
    p = [900.0, 0, 630, 0, 0, 910, 350, 0, 0, 0, 1, 0]
    entry = camera_entry(info(d=[0.1] * 5, p=p), UNMOVED, is_rectified=True)
    sent = [entry[name] for name in ("model", "fx_px", "fy_px", "cx_px", "cy_px", "distortion")]
    assert sent == ["pinhole", 900, 910, 630.5, 350.5, []]


def test_a_binned_part_of_the_sensor_shows_what_the_sensor_shows_there() -> None:
    roi = SimpleNamespace(x_offset=200, y_offset=100, width=800, height=600)
    entry = camera_entry(info(roi=roi, binning_x=2, binning_y=2), UNMOVED)
    assert (entry["width_px"], entry["height_px"]) == (400, 300)
    # A direction that the sensor has at pixel (c, r), counted from its corner, is at half of (c - 200, r - 100).
    column, row = 0.1 * FX + CX, 0.2 * FY + CY
    found = 0.1 * entry["fx_px"] + entry["cx_px"], 0.2 * entry["fy_px"] + entry["cy_px"]
    assert found == pytest.approx(((column - 200) / 2, (row - 100) / 2))


@pytest.mark.parametrize("given", [{"k": [0.0] * 9}, {"distortion_model": "ftheta", "d": [0.1]}])
def test_intrinsics_that_cannot_be_sent_are_refused_with_what_to_do(given: dict[str, Any]) -> None:
    with pytest.raises(UnusableError, match=r"calibrate|rectified"):
        camera_entry(info(**given), UNMOVED)


def test_the_known_pose_and_its_pixels_arrive_at_the_service() -> None:
    """The pose of tests/docs/ar_devices, which was worked out apart from this code, as tf has it for an optical frame."""
    position, turn = (
        SimpleNamespace(**dict(zip(names, values, strict=True)))
        for names, values in (("xyz", POSITION["opencv"]), ("xyzw", QUATERNION["opencv"]))
    )
    tf = pose_of(position, turn)
    options = LocalizeOptions.model_validate({"frame": "opencv", "cameras": [camera_entry(info(), tf)]})
    assert options.cameras is not None
    (sent,) = options.cameras
    assert sent.session_from_camera is not None
    tracked, camera = sent.session_from_camera.to_options(), sent.to_options()
    assert camera is not None
    pose = CorePose.from_frame(tracked.position_m, tracked.quaternion_xyzw, options.frame)
    np.testing.assert_allclose(pose.position, POSITION["ros"], atol=1e-8)
    np.testing.assert_allclose(pose.quaternion_xyzw, QUATERNION["ros"], atol=2e-8)
    direction = pose.inverse().matrix @ (*SCAN_POINT, 1)
    u, v, shown = project_to_image(camera.of_image((WIDTH, HEIGHT), (WIDTH, HEIGHT)), direction[None, :3])
    forward, left, up = SEEN
    assert shown.all()
    assert (u[0], v[0]) == pytest.approx((CX - FX * left / forward, CY - FY * up / forward), abs=1e-4)


def test_map_from_session_is_the_transform_from_map_to_odom() -> None:
    """A session that begins at the known pose with its camera's axes: tf of a child maps its coordinates to the parent's."""
    known = CorePose.from_frame(POSITION["ros"], QUATERNION["ros"], "ros")
    found = known.after(CorePose.from_frame((0, 0, 0), (0, 0, 0, 1), "opencv").inverse()).between_worlds("opencv")
    map_from_odom = from_json(
        {
            "position_m": dict(zip("xyz", found.position.tolist(), strict=True)),
            "quaternion": dict(zip("xyzw", found.quaternion_xyzw.tolist(), strict=True)),
        }
    )
    forward, left, up = SEEN
    seen = map_from_odom.rotation @ (-left, -up, forward) + map_from_odom.position
    np.testing.assert_allclose(seen, SCAN_POINT, atol=2e-8)
