"""Which photos are placed on the sphere, by which camera, and what is said about the others."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.errors import CoreError, OptionsError, PanoramaDamagedError, PanoramaShapeError, PanoramaUnusableError
from panoloc.core.image.known_camera import shown_camera
from panoloc.core.image.reader import read_image, read_panorama
from panoloc.core.options import MAX_PIXELS
from tests.core.image.picture_files import encoded, gpano_packet, photo_file, picture

PHONE = CameraDescription("pinhole", hfov_deg=69.0)
PHOTO = encoded(picture(640, 480))


def width_and_height_deg(valid: np.ndarray) -> tuple[float, float]:
    """Return how much of the horizon, and of the meridian ahead, is visible."""
    rows, columns = valid.shape
    return 360 * valid[rows // 2].mean(), 180 * valid[:, columns // 2].mean()


def test_a_phones_photo_is_placed_by_its_exif_data() -> None:
    found = read_panorama(photo_file(picture(900, 600), focal_mm=26))
    assert width_and_height_deg(found.valid) == pytest.approx((69.4, 49.6), abs=1.0)


@pytest.mark.parametrize(
    ("taken", "is_told"),
    [
        ((900, 600), False),
        ((600, 900), False),
        ((0, 0), False),
        ((900, 0), False),
        ((3600, 2400), True),
        ((2400, 3600), True),
        ((3604, 2400), True),
    ],
)
def test_a_copy_of_its_shape_is_taken_for_all_of_the_photo_and_one_of_another_size_is_told(
    taken: tuple[int, int], is_told: bool
) -> None:
    found = read_image(photo_file(picture(900, 600), focal_mm=26, taken=taken))
    assert found.camera.hfov_deg == pytest.approx(69.4, abs=0.1)
    assert [words.partition(", which")[0] for words in found.left_out] == [
        f"the EXIF data describe an image of {max(taken)} x {min(taken)} px, got 900 x 600"
    ] * is_told


def test_a_camera_that_is_said_of_many_images_is_not_that_of_the_panoramas_among_them() -> None:
    for camera in (PHONE, CameraDescription("pinhole", hfov_range_deg=(45.0, 90.0))):
        of_photos = replace(camera, unless_panorama=True)
        sphere, part = (
            encoded(picture(640, 320)),
            encoded(picture(400, 100), "JPEG", xmp=gpano_packet((800, 400), (100, 100), (400, 100))),
        )
        for panorama in (sphere, part):
            assert read_image(panorama, camera=of_photos).camera.is_whole_sphere
            assert shown_camera(panorama, of_photos, MAX_PIXELS).camera.is_whole_sphere
        assert read_image(sphere, camera=camera).camera.model == "pinhole"
        assert read_image(PHOTO, camera=of_photos).hfov_range_deg == camera.hfov_range_deg
        assert read_image(PHOTO, camera=of_photos).camera.model == "pinhole"


def test_a_large_photo_that_is_decoded_smaller_is_not_taken_for_a_copy() -> None:
    found = read_image(photo_file(picture(4032, 3024), focal_mm=26, taken=(4032, 3024)))
    assert found.camera.width_px < 4032
    assert found.left_out == ()


def test_of_a_crop_whose_camera_is_told_nobody_asks_what_it_was_before() -> None:
    cut = photo_file(picture(900, 600), focal_mm=26, taken=(4032, 3024))
    camera = CameraDescription("pinhole", 900, 600, fx_px=700.0, cx_px=200.0, cy_px=300.0)
    assert read_image(cut, camera=camera).camera.cx_px == 200.0


def test_a_focal_length_in_whole_millimetres_is_known_no_better_than_they_say() -> None:
    for focal_mm in (26, 77):
        found = read_image(photo_file(picture(900, 600), focal_mm))
        assert found.focal_uncertainty == pytest.approx(0.34 / focal_mm)
    assert read_image(PHOTO, camera=PHONE).focal_uncertainty == PHONE.focal_uncertainty > 0


def test_a_portrait_photo_is_turned_upright() -> None:
    stored = np.zeros((600, 900, 3), np.uint8)
    stored[:, :450] = 250  # the left half: up, once the photo is turned by orientation 6
    found = read_panorama(photo_file(stored, focal_mm=26, orientation=6))
    assert width_and_height_deg(found.valid) == pytest.approx((49.6, 69.4), abs=1.0)
    rows = found.valid.shape[0]
    middle = found.color[:, found.valid.shape[1] // 2]
    assert middle[rows // 2 - rows // 16].min() > 240
    assert middle[rows // 2 + rows // 16].max() < 10


def test_intrinsics_of_the_sensor_leave_a_portrait_photo_as_it_is_stored() -> None:
    data = photo_file(picture(900, 600), orientation=6)
    found = read_panorama(data, camera=CameraDescription("pinhole", 1800, 1200, fx_px=1300.0))
    assert width_and_height_deg(found.valid) == pytest.approx((69.4, 49.6), abs=1.0)


def test_a_given_camera_goes_before_what_the_shape_suggests() -> None:
    found = read_panorama(encoded(picture(640, 320)), camera=CameraDescription("pinhole", hfov_deg=60.0))
    assert found.valid.mean() < 0.1


def test_a_mask_lies_on_the_photo_and_not_on_the_sphere() -> None:
    mask = np.zeros((480, 640), np.uint8)
    mask[:, :320] = 255
    found = read_panorama(PHOTO, encoded(mask), camera=PHONE)
    rows, columns = found.valid.shape
    assert not found.valid[:, : columns // 2 - 1].any()
    assert found.valid[rows // 2, columns // 2 + 2 : columns // 2 + 20].all()


@pytest.mark.slow
def test_a_large_photo_is_as_good_as_its_small_copy() -> None:
    small, large = picture(1000, 750), np.asarray(Image.fromarray(picture(1000, 750)).resize((4000, 3000)))
    first, second = (read_panorama(encoded(each, "JPEG", quality=95), camera=PHONE) for each in (small, large))
    both = first.valid & second.valid
    assert (first.valid ^ second.valid).mean() < 0.002
    assert np.abs(first.color[both].astype(float) - second.color[both]).mean() < 2


@pytest.mark.parametrize(
    ("data", "camera", "error", "said"),
    [
        (PHOTO, None, PanoramaShapeError, r"2:1 .* 640 x 480 .* EXIF .* \(options\.cameras\).* \(hfov_deg"),
        (
            photo_file(picture(900, 600), focal_mm=26, taken=(4032, 3024)),
            None,
            PanoramaShapeError,
            r"4032 x 3024 px by its EXIF data, got 900 x 600 px.*\(cx_px, cy_px\)",
        ),
        (photo_file(picture(900, 600))[:9000], None, PanoramaDamagedError, "the file ends early"),
        (photo_file(picture(900, 600)), None, PanoramaShapeError, "2:1"),
        (PHOTO, CameraDescription("pinhole", 1920, 1080, fx_px=1400.0), OptionsError, "1920 x 1080 px"),
        (encoded(picture(20, 8)), PHONE, PanoramaUnusableError, "at least 16 pixels a side, got 20 x 8"),
        (
            PHOTO,
            CameraDescription("opencv", 640, 480, 500.0, distortion=(-50.0, 1000.0, 0.0, 0.0)),
            OptionsError,
            r"^distortion: expected coefficients that are valid .* leave \d+% of it",
        ),
        (PHOTO, CameraDescription("pinhole", hfov_deg=1.5), PanoramaUnusableError, r"at least 0\.1%"),
    ],
    ids=[
        "nothing known",
        "cropped",
        "ends early",
        "a whole JPEG",
        "another image",
        "few pixels",
        "wild distortion",
        "next to nothing",
    ],
)
def test_a_photo_that_cannot_be_placed_is_refused_with_what_to_send(
    data: bytes, camera: CameraDescription | None, error: type[CoreError], said: str
) -> None:
    with pytest.raises(error, match=said):
        read_panorama(data, camera=camera)
