"""HEIC and AVIF, as phones take photos: they show what their JPEG shows, and what cannot be read is refused with the reason."""

import io
import time
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.errors import (
    MaskTooLargeError,
    PanoramaDamagedError,
    PanoramaFormatError,
    PanoramaTooLargeError,
)
from panoloc.core.image.conversion import converted
from panoloc.core.image.image_header import IMAGE, MASK, open_image
from panoloc.core.image.reader import read_image
from panoloc.core.options import MAX_PIXELS
from tests.core.image.picture_files import encoded, heic, phone_exif, photo_file, picture

PIXELS = picture(480, 320)
PHONE = CameraDescription("pinhole", hfov_deg=69.0)
VIDEO = b"\0\0\0\x18ftypisom\0\0\2\0isomiso2" + b"\0\0\1\0mdat" + bytes(248)
SIZE = b"ispe\0\0\0\0" + (480).to_bytes(4, "big") + (320).to_bytes(4, "big")


def size_box(width: int, height: int) -> bytes:
    return b"ispe\0\0\0\0" + width.to_bytes(4, "big") + height.to_bytes(4, "big")


@pytest.mark.parametrize("focal_mm", [13, 26, 77], ids=["ultra-wide", "wide", "tele"])
@pytest.mark.parametrize("orientation", [1, 6], ids=["landscape", "portrait"])
def test_a_heic_has_the_pixels_and_the_camera_of_its_jpeg(focal_mm: int, orientation: int) -> None:
    expected = read_image(photo_file(PIXELS, focal_mm, orientation))
    found = read_image(heic(PIXELS, phone_exif(focal_mm, orientation)))
    assert found.camera == expected.camera
    assert found.focal_uncertainty == expected.focal_uncertainty
    assert np.abs(found.color.astype(int) - expected.color).mean() < 2


@pytest.mark.parametrize(
    "made",
    [
        lambda: heic(PIXELS.astype(np.uint16) * 257),
        lambda: heic(PIXELS, b"", picture(64, 64, seed=1)),
        lambda: heic(PIXELS) + len(VIDEO).to_bytes(4, "big") + b"mpvd" + VIDEO,
        lambda: heic(PIXELS) + b"MotionPhoto_Data" + VIDEO,
        lambda: encoded(PIXELS, "JPEG", quality=97) + VIDEO,
        lambda: encoded(PIXELS, "AVIF", quality=95),
        lambda: encoded(
            PIXELS, "AVIF", quality=95, save_all=True, append_images=[Image.fromarray(picture(480, 320, seed=1))]
        ),
    ],
    ids=["10 bit", "two images", "Google's motion", "Samsung's motion", "JPEG with motion", "AVIF", "AVIF sequence"],
)
def test_what_phones_and_cameras_put_into_a_file_beside_the_photo_changes_nothing(made: Callable[[], bytes]) -> None:
    found = read_image(made(), camera=PHONE)
    assert np.abs(found.color.astype(int) - PIXELS).mean() < 3


def test_what_an_alpha_channel_hides_is_ignored() -> None:
    alpha = np.full((320, 480, 1), 255, np.uint8)
    alpha[:, :200] = 0
    found = read_image(heic(np.concatenate([PIXELS, alpha], axis=2)), camera=PHONE)
    assert not found.valid[:, :190].any()
    assert found.valid[:, 210:].all()


def test_a_mask_may_be_an_avif() -> None:
    mask = np.zeros((320, 480, 3), np.uint8)
    mask[:, :240] = 255
    found = read_image(encoded(PIXELS), encoded(mask, "AVIF", quality=100), camera=PHONE)
    assert not found.valid[:, :236].any()
    assert found.valid[:, 244:].all()


def test_the_jpeg_of_a_heic_is_upright_and_keeps_exif_data_but_not_the_makers_note() -> None:
    data = converted(heic(PIXELS, phone_exif(26, orientation=6)), IMAGE, MAX_PIXELS)
    with Image.open(io.BytesIO(data)) as jpeg:
        exif = jpeg.getexif()
        assert (jpeg.format, jpeg.size, exif.get(0x0112, 1)) == ("JPEG", (320, 480), 1)
        assert exif.get_ifd(0x8769)[0xA405] == 26
        assert exif.get_ifd(0x8825)[1] == "N"
        assert 0x927C not in exif.get_ifd(0x8769)


@pytest.mark.parametrize("kind", ["heic", "avif"])
@pytest.mark.parametrize("share", [0.01, 0.2, 0.9])
def test_a_file_that_ends_early_is_refused(kind: str, share: float) -> None:
    data = heic(PIXELS) if kind == "heic" else encoded(PIXELS, "AVIF")
    with pytest.raises(PanoramaDamagedError, match=r"ends early|ends within its header"):
        read_image(data[: int(len(data) * share)], camera=PHONE)


def test_a_file_that_crashes_its_decoder_is_refused_as_a_damaged_one() -> None:
    data = heic(PIXELS, phone_exif())
    at = data.index(b"Exif\0")  # the type of an item, which pi-heif 1.4 takes for UTF-8
    with pytest.raises(PanoramaDamagedError, match="upload it again in full, or as JPEG"):
        read_image(data[:at] + b"\xecxif" + data[at + 4 :], camera=PHONE)


def test_a_bomb_is_refused_by_its_header_and_one_that_lies_there_by_its_decoder() -> None:
    data, began = heic(PIXELS), time.perf_counter()
    for bomb in (
        data.replace(SIZE, size_box(40_000, 20_000)),
        encoded(PIXELS, "AVIF").replace(SIZE, size_box(40_000, 20_000)),
    ):
        with pytest.raises(PanoramaTooLargeError, match="40,000 x 20,000"):
            open_image(bomb, IMAGE, MAX_PIXELS)
    with pytest.raises(MaskTooLargeError, match=r"^mask: "):
        open_image(data, MASK, 480 * 320 - 1)
    many_boxes = b"\0\0\0\x10ftypheic\0\0\0\0" + b"\0\0\0\x08free" * 2_000_000
    with pytest.raises(PanoramaDamagedError, match="no still image"):
        open_image(many_boxes, IMAGE, MAX_PIXELS)
    assert time.perf_counter() - began < 1
    with pytest.raises(PanoramaDamagedError, match="damaged"):
        read_image(data.replace(SIZE, size_box(64, 64)), camera=PHONE)


def test_videos_and_sequences_without_a_still_image_are_no_photos() -> None:
    with pytest.raises(PanoramaFormatError, match="got a video"):
        read_image(VIDEO, camera=PHONE)
    with pytest.raises(PanoramaDamagedError, match="no still image, which sequences do not"):
        read_image(b"\0\0\0\x14ftyphevc\0\0\0\0msf1" + VIDEO[24:], camera=PHONE)
