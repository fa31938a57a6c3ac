"""The code for AR frameworks, of docs/ar and of the npm package, sends what the service takes it for, and undoes its answer rightly."""

import json

import numpy as np
import pytest

from panoloc.core.camera.lens import project_to_image
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import Frame
from panoloc.service.http.schemas.queries import Camera, LocalizeOptions
from tests.docs.ar_devices import (
    CX,
    CY,
    ENTRIES,
    FRAME,
    FX,
    FY,
    HEIGHT,
    POSITION,
    QUATERNION,
    SCAN_POINT,
    SEEN,
    WIDTH,
    placed_content,
    sent_options,
    webxr_projection,
)

PLATFORMS = pytest.mark.parametrize("platform", list(ENTRIES))


def taken(platform: str) -> LocalizeOptions:
    """Return the options of a snippet as the service takes them."""
    return LocalizeOptions.model_validate_json(json.dumps(sent_options(platform)))


def sent_camera(platform: str) -> Camera:
    cameras = taken(platform).cameras
    assert cameras is not None
    (camera,) = cameras
    return camera


def sent_pose(platform: str) -> Pose:
    """Return `session_from_camera` of a snippet as the service understands it."""
    options, camera = taken(platform), sent_camera(platform)
    assert camera.session_from_camera is not None
    tracked = camera.session_from_camera.to_options()
    return Pose.from_frame(tracked.position_m, tracked.quaternion_xyzw, options.frame)


@PLATFORMS
def test_the_service_takes_what_a_snippet_sends(platform: str) -> None:
    options = taken(platform)
    assert options.frame == FRAME[platform]
    assert options.session is not None
    assert options.session.to_options().up_known
    camera = sent_camera(platform).to_options()
    assert camera is not None
    assert (camera.width_px, camera.height_px) == (WIDTH, HEIGHT)
    assert (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) == pytest.approx((FX, FY, CX, CY), abs=1e-6)


@PLATFORMS
def test_a_snippet_sends_the_known_pose(platform: str) -> None:
    pose = sent_pose(platform)
    np.testing.assert_allclose(pose.position, POSITION["ros"], atol=1e-8)
    np.testing.assert_allclose(pose.quaternion_xyzw, QUATERNION["ros"], atol=2e-8)


@PLATFORMS
def test_a_snippet_sends_the_axes_and_the_intrinsics_of_one_image(platform: str) -> None:
    """A point of the scan lands on the pixel where the device has it."""
    pose, camera = sent_pose(platform), sent_camera(platform).to_options()
    assert camera is not None
    direction = pose.inverse().matrix @ (*SCAN_POINT, 1)
    u, v, shown = project_to_image(camera.of_image((WIDTH, HEIGHT), (WIDTH, HEIGHT)), direction[None, :3])
    forward, left, up = SEEN
    assert shown.all()
    assert (u[0], v[0]) == pytest.approx((CX - FX * left / forward, CY - FY * up / forward), abs=1e-4)


def test_the_pixels_of_webxr_are_those_that_its_projection_draws_turned_over() -> None:
    forward, left, up = SEEN
    clip = webxr_projection() @ (-left, up, -forward, 1)
    column, row = (clip[0] / clip[3] + 1) / 2 * WIDTH, (1 - clip[1] / clip[3]) / 2 * HEIGHT
    assert (column, row) == pytest.approx((CX - FX * left / forward, CY - FY * up / forward), abs=1e-9)


def answered(frame: Frame) -> Pose:
    """Return `map_from_session` of a session that begins at the known pose with its camera's axes, in the axes of the answer."""
    known = Pose.from_frame(POSITION["ros"], QUATERNION["ros"], "ros")
    session_from_camera = Pose.from_frame((0, 0, 0), (0, 0, 0, 1), frame)
    found = known.after(session_from_camera.inverse()).between_worlds(frame)
    np.testing.assert_allclose(found.position, POSITION[frame], atol=1e-8)
    np.testing.assert_allclose(found.quaternion_xyzw, QUATERNION[frame], atol=2e-8)
    return found


@pytest.mark.parametrize("platform", ["ARKit", "ARCore", "WebXR"])
def test_content_of_the_scan_stands_in_the_session_where_the_camera_sees_it(platform: str) -> None:
    # The session has the camera's own axes: right, up, backward.
    found = answered("webxr").inverse().matrix @ (*placed_content(platform), 1)
    forward, left, up = SEEN
    np.testing.assert_allclose(found[:3], (-left, up, -forward), atol=2e-8)
