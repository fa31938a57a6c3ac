"""Which image files become panoramas, how, and what is said about the others."""

import io
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from panoloc.core import errors
from panoloc.core.image.reader import read_panorama
from tests.core.image.picture_files import (
    encoded,
    gpano_packet,
    photo_file,
    picture,
    png_16_bit,
    png_bomb,
)


def difference(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found.astype(float) - expected.astype(float)).mean())


@pytest.mark.parametrize(
    ("kind", "options", "tolerance"), [("PNG", {}, 0), ("JPEG", {"quality": 95}, 3), ("WEBP", {"lossless": True}, 0)]
)
def test_jpeg_png_and_webp_keep_their_pixels_and_are_valid_everywhere(
    kind: str, options: dict[str, object], tolerance: float
) -> None:
    pixels = picture()
    panorama = read_panorama(encoded(pixels, kind, **options))
    assert panorama.color.shape == (128, 256, 3)
    assert panorama.color.dtype == np.uint8
    assert difference(panorama.color, pixels) <= tolerance
    assert panorama.valid.all()


@pytest.mark.parametrize("kind", ["colour", "grey"])
def test_a_16_bit_png_is_brought_to_8_bit_in_all_channels(kind: str) -> None:
    pixels = picture() if kind == "colour" else picture()[..., 0]
    panorama = read_panorama(png_16_bit(pixels.astype(np.uint16) * 257))
    for channel in range(3):
        assert difference(panorama.color[..., channel], pixels[..., channel] if kind == "colour" else pixels) <= 1


@pytest.mark.parametrize("mode", ["L", "P", "CMYK"])
def test_grey_palette_and_cmyk_pictures_become_rgb(mode: str) -> None:
    image = Image.fromarray(picture()).convert(mode)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG" if mode == "CMYK" else "PNG", **({"quality": 95} if mode == "CMYK" else {}))
    panorama = read_panorama(buffer.getvalue())
    assert difference(panorama.color, np.asarray(image.convert("RGB"))) <= 4
    assert panorama.valid.all()


@pytest.mark.parametrize("orientation", [*range(1, 9), 0, 9, 65535])
def test_exif_orientation_is_honoured(orientation: int) -> None:
    upright = picture()
    undo: dict[int, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] = {
        2: np.fliplr,
        3: lambda a: np.rot90(a, 2),
        4: np.flipud,
        5: lambda a: a.swapaxes(0, 1),
        6: np.rot90,
        7: lambda a: np.rot90(a.swapaxes(0, 1), 2),
        8: lambda a: np.rot90(a, -1),
    }
    # A number that is no orientation turns nothing.
    stored = np.ascontiguousarray(undo[orientation](upright) if orientation in undo else upright)
    panorama = read_panorama(photo_file(stored, orientation=orientation))
    assert panorama.color.shape == (128, 256, 3)
    assert difference(panorama.color, upright) < 4


def test_a_mask_of_another_resolution_is_scaled() -> None:
    mask = np.zeros((64, 128), np.uint8)
    mask[:, 96:] = 1
    panorama = read_panorama(encoded(picture()), encoded(mask))
    assert panorama.valid[:, :192].all()
    assert not panorama.valid[:, 192:].any()


def test_mask_and_alpha_add_up() -> None:
    alpha, mask = np.full((128, 256, 1), 255, np.uint8), np.zeros((128, 256), np.uint8)
    alpha[:, :64], mask[:, 192:] = 0, 255
    panorama = read_panorama(encoded(np.concatenate((picture(), alpha), axis=2)), encoded(mask))
    assert panorama.valid[:, 64:192].all()
    assert panorama.valid.sum() == 128 * 128


def test_a_transparent_picture_is_not_blamed_on_its_mask() -> None:
    transparent = np.concatenate((picture(), np.zeros((128, 256, 1), np.uint8)), axis=2)
    with pytest.raises(errors.PanoramaUnusableError, match=r"image: .*alpha") as refused:
        read_panorama(encoded(transparent), encoded(np.zeros((128, 256), np.uint8)))
    assert not isinstance(refused.value, errors.MaskShapeError)


@pytest.mark.parametrize("as_elements", [False, True])
@pytest.mark.parametrize("kind", ["JPEG", "WEBP"])
def test_gpano_crop_fields_place_a_partial_panorama_in_the_full_sphere(kind: str, as_elements: bool) -> None:
    part = picture(200, 60)
    packet = gpano_packet((400, 200), (120, 50), (200, 60), as_elements)
    panorama = read_panorama(encoded(part, kind, quality=95, xmp=packet))
    assert panorama.color.shape == (200, 400, 3)
    expected = np.zeros((200, 400), bool)
    expected[50:110, 120:320] = True
    np.testing.assert_array_equal(panorama.valid, expected)
    assert difference(panorama.color[50:110, 120:320], part) < 5


def test_gpano_crop_fields_follow_a_picture_that_was_scaled_down_after_them() -> None:
    packet = gpano_packet((800, 400), (240, 100), (400, 120))
    panorama = read_panorama(encoded(picture(200, 60), "JPEG", xmp=packet))
    assert panorama.valid.shape == (200, 400)
    assert panorama.valid[50:110, 120:320].all()
    assert panorama.valid.sum() == 60 * 200


@pytest.mark.parametrize("size", [(257, 128), (255, 128), (1001, 500), (4098, 2049)])
def test_a_pixel_more_or_less_than_two_to_one_is_forgiven(size: tuple[int, int]) -> None:
    panorama = read_panorama(encoded(picture(*size), "JPEG"))
    assert panorama.valid.shape[1] == 2 * panorama.valid.shape[0]


def test_the_pixel_limit_is_the_callers() -> None:
    data = encoded(picture())
    read_panorama(data, max_pixels=256 * 128)
    with pytest.raises(errors.PanoramaTooLargeError, match="256 x 128"):
        read_panorama(data, max_pixels=256 * 128 - 1)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP"])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_picture_that_ends_early_is_refused_and_told_so(kind: str, share: float) -> None:
    data = encoded(picture(), kind)
    with pytest.raises(errors.PanoramaDamagedError if kind != "WEBP" else errors.PanoramaError):
        read_panorama(data[: int(share * len(data))])


@pytest.mark.parametrize("data", [b"", b"hello, this is no picture", b"%PDF-1.7 ...", b"GIF89a" + bytes(100), b"\xff"])
def test_text_and_other_files_are_refused_with_what_was_expected(data: bytes) -> None:
    with pytest.raises(errors.PanoramaFormatError, match="expected a JPEG, PNG, WebP, HEIC or AVIF"):
        read_panorama(data)


PANORAMA = encoded(picture())


@pytest.mark.parametrize(
    ("mask", "error", "said"),
    [
        (encoded(np.zeros((128, 128), np.uint8)), errors.MaskShapeError, "mask"),
        (encoded(np.full((128, 256), 255, np.uint8)), errors.MaskShapeError, "a mask that hides all pixels"),
        (b"", errors.MaskFormatError, "mask: "),
        (b"hello, no picture", errors.MaskFormatError, "mask: "),
        (PANORAMA[:300], errors.MaskDamagedError, "mask: "),
        (png_bomb(40_000, 20_000), errors.MaskTooLargeError, "mask"),
    ],
)
def test_a_mask_is_blamed_by_its_own_error(mask: bytes, error: type[errors.PanoramaError], said: str) -> None:
    with pytest.raises(error, match=said):
        read_panorama(PANORAMA, mask)


def cropped(size: tuple[int, int], full: tuple[int, int], left_top: tuple[int, int], part: tuple[int, int]) -> bytes:
    return encoded(picture(*size), "JPEG", xmp=gpano_packet(full, left_top, part))


@pytest.mark.parametrize(
    ("data", "error", "said"),
    [
        (encoded(picture(300, 200)), errors.PanoramaShapeError, r"2:1.*300 x 200.*1\.50:1"),
        (encoded(picture(64, 32)), errors.PanoramaUnusableError, "at least"),
        (png_bomb(40_000, 20_000), errors.PanoramaTooLargeError, "40,000 x 20,000"),
        # Crop fields: that contradict each other, that blow a small picture up, and of a row among millions.
        (cropped((200, 60), (400, 200), (300, 50), (200, 60)), errors.PanoramaUnusableError, "GPano"),
        (cropped((20, 10), (4000, 2000), (0, 0), (20, 10)), errors.PanoramaTooLargeError, "pixels"),
        (cropped((2000, 16), (2_000_000, 1_000_000), (0, 0), (1_000_000, 1)), errors.PanoramaError, "."),
    ],
)
def test_what_is_no_panorama_is_refused_and_told_so(data: bytes, error: type[errors.PanoramaError], said: str) -> None:
    with pytest.raises(error, match=said):
        read_panorama(data, max_pixels=1_000_000)
