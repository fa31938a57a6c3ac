"""Uploaded images become what is localized: a rig whose poses are in the axes of `core`."""

import io
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from panoloc.core.camera.camera import Camera, CameraDescription
from panoloc.core.errors import PanoramaDamagedError, PanoramaTooLargeError
from panoloc.core.geometry.pose import Pose
from panoloc.core.options import SessionOptions, TrackedPose
from panoloc.core.results import Candidate, Localization, SearchSummary
from panoloc.service.jobs import QueryImage
from panoloc.service.worker.query_images import as_found, read_query, shown_on_sphere
from tests.core.image.picture_files import encoded, heic, phone_exif, picture

PINHOLE = CameraDescription("pinhole", hfov_deg=60)
NO_SESSION = SessionOptions()
MAX_PIXELS = 10**7


def grey(width: int, height: int) -> bytes:
    return encoded(np.full((height, width, 3), 128, np.uint8))


def frame_image(tracked: TrackedPose | None = None, data: bytes | None = None) -> QueryImage:
    return QueryImage(data or grey(64, 48), camera=PINHOLE, session_from_camera=tracked or TrackedPose())


def found_at(pose: Pose, map_from_session: Pose | None) -> Localization:
    best = Candidate(pose, 0, 0.9, 1.0, 0.1, "none", 10)
    return Localization("localized", SearchSummary("fast", 1, 1, 1, 1), {}, best, map_from_session=map_from_session)


def test_one_image_without_a_pose_is_no_session() -> None:
    sphere = read_query([QueryImage(grey(128, 64))], "webxr", NO_SESSION, MAX_PIXELS)
    photo = read_query([QueryImage(grey(64, 48), camera=PINHOLE)], "webxr", NO_SESSION, MAX_PIXELS)
    for rig, hfov_deg in ((sphere, 360.0), (photo, 60.0)):
        (image,) = rig.images
        np.testing.assert_array_equal(image.session_from_camera.matrix, np.eye(4))
        assert image.photo.camera.hfov_deg == pytest.approx(hfov_deg)


def test_photos_of_several_lenses_in_one_session_have_each_its_own_camera() -> None:
    shots = [heic(picture(144, 96, seed=focal), phone_exif(focal, orientation=6)) for focal in (13, 26, 77)]
    images = [QueryImage(shot, session_from_camera=TrackedPose()) for shot in shots]
    cameras = [photo.camera for photo in read_query(images, "webxr", NO_SESSION, MAX_PIXELS).photos]
    assert [(camera.width_px, camera.height_px) for camera in cameras] == [(96, 144)] * 3
    diagonal_px = math.hypot(96, 144)
    assert [camera.fx_px * math.hypot(36, 24) / diagonal_px for camera in cameras] == pytest.approx([13, 26, 77])


def test_a_photo_is_drawn_with_the_field_of_view_that_the_search_found() -> None:
    camera = CameraDescription("pinhole", hfov_range_deg=(45.0, 90.0))
    rig = read_query([QueryImage(grey(64, 48), camera=camera)], "webxr", NO_SESSION, MAX_PIXELS)
    assert rig.photos[0].hfov_range_deg == (45.0, 90.0)
    unknown = found_at(Pose(np.eye(3), np.zeros(3)), None)
    assert as_found(rig, unknown) is rig
    found = replace(unknown, found_cameras=(Camera.from_hfov("pinhole", 64, 48, 52.0),))
    (shown,) = as_found(rig, found).photos
    assert shown.camera.hfov_deg == pytest.approx(52.0)
    assert shown.hfov_range_deg is None


def test_images_are_drawn_with_the_cameras_that_the_search_found() -> None:
    session = read_query([frame_image(), frame_image()], "ros", NO_SESSION, MAX_PIXELS)
    given = session.photos[0].camera
    fitting = tuple(Camera.from_hfov("pinhole", given.width_px, given.height_px, width) for width in (50.0, 51.0))
    found = replace(found_at(Pose(np.eye(3), np.zeros(3)), None), found_cameras=fitting)
    assert [photo.camera for photo in as_found(session, found).photos] == list(fitting)


def test_poses_are_brought_from_the_axes_of_the_caller_to_those_of_the_algorithm() -> None:
    # A WebXR device one metre to the right of where it began and two up, looking to the right: about y by -90 degrees.
    tracked = TrackedPose((1.0, 2.0, 0.0), (0.0, -math.sqrt(0.5), 0.0, math.sqrt(0.5)))
    options = SessionOptions(up_known=True, position_noise_m=0.02)
    session = read_query([frame_image(), frame_image(tracked)], "webxr", options, MAX_PIXELS)
    assert session.options == options
    first, second = (image.session_from_camera for image in session.images)
    # z up, and y where the device looked at first.
    np.testing.assert_allclose(first.rotation @ (1, 0, 0), (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(second.rotation @ (1, 0, 0), (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(second.rotation @ (0, 0, 1), (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(second.position, (1, 0, 2), atol=1e-12)


def test_one_image_with_a_pose_is_a_session_also_a_full_panorama() -> None:
    image = QueryImage(grey(128, 64), session_from_camera=TrackedPose((1.0, 0.0, 0.0)))
    session = read_query([image], "ros", NO_SESSION, MAX_PIXELS)
    assert session.images[0].photo.camera.model == "equirectangular"
    np.testing.assert_array_equal(session.images[0].session_from_camera.position, (1, 0, 0))


def test_each_image_has_its_own_mask() -> None:
    hidden = np.zeros((48, 64, 3), np.uint8)
    hidden[:, :32] = 255
    images = [frame_image(), replace(frame_image(), mask=encoded(hidden))]
    session = read_query(images, "ros", NO_SESSION, MAX_PIXELS)
    first, second = (photo.valid for photo in session.photos)
    assert first.all()
    assert not second[:, :32].any()
    assert second[:, 32:].all()


def test_an_error_says_which_of_several_images_it_is_about() -> None:
    with pytest.raises(PanoramaDamagedError, match=r"\(image 2 of 2\)"):
        read_query([frame_image(), frame_image(data=grey(64, 48)[:60])], "ros", NO_SESSION, MAX_PIXELS)
    with pytest.raises(PanoramaDamagedError) as caught:
        read_query([QueryImage(grey(128, 64)[:60])], "ros", NO_SESSION, MAX_PIXELS)
    assert "of 1" not in str(caught.value)


def test_crops_of_spheres_count_as_whole_spheres() -> None:
    fields = {"FullPanoWidthPixels": 2000, "FullPanoHeightPixels": 1000, "CroppedAreaLeftPixels": 0,
              "CroppedAreaTopPixels": 400, "CroppedAreaImageWidthPixels": 400, "CroppedAreaImageHeightPixels": 200}  # fmt: skip
    packet = "".join(f'GPano:{name}="{value}" ' for name, value in fields.items())
    buffer = io.BytesIO()
    Image.new("RGB", (400, 200)).save(buffer, "JPEG", xmp=f"<x:xmpmeta {packet}></x:xmpmeta>".encode())
    crop = QueryImage(buffer.getvalue(), session_from_camera=TrackedPose())
    assert read_query([crop], "ros", NO_SESSION, 3_000_000).photos[0].valid.shape == (1000, 2000)
    with pytest.raises(PanoramaTooLargeError, match=r"3,000,000 pixels over all images, got 4,000,000 .*image 2 of 2"):
        read_query([crop, crop], "ros", NO_SESSION, 3_000_000)


def test_pictures_of_a_session_are_drawn_at_the_pose_of_its_sphere() -> None:
    # Two cameras, the second turned to the left; in its middle a red patch, so the sphere shows red where it looks.
    pixels = np.full((48, 64, 3), 128, np.uint8)
    pixels[20:28, 28:36] = (255, 0, 0)
    to_the_left = TrackedPose((0.0, 0.5, 0.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    session = read_query([frame_image(), frame_image(to_the_left, encoded(pixels))], "ros", NO_SESSION, MAX_PIXELS)
    map_from_session = Pose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([4.0, 5.0, 1.0]))
    first = map_from_session.after(session.images[0].session_from_camera)
    sphere, shown = shown_on_sphere(session, found_at(first, map_from_session))
    rows, columns = np.nonzero((sphere.color[..., 0] > 200) & (sphere.color[..., 1] < 60) & sphere.valid)
    azimuth = math.pi - 2 * math.pi * (columns.mean() + 0.5) / sphere.valid.shape[1]
    elevation = math.pi / 2 - math.pi * (rows.mean() + 0.5) / sphere.valid.shape[0]
    seen = np.array(
        [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
    )
    assert shown.best is not None
    # To the left of a session that is itself turned to the left is backwards in the map.
    np.testing.assert_allclose(shown.best.pose.rotation @ seen, (-1, 0, 0), atol=0.02)
    np.testing.assert_allclose(shown.best.pose.position, (4 - 0.25, 5, 1), atol=1e-9)
