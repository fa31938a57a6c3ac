"""Photos that nothing is known of are refused before they are decoded, and no photo that the reader would take."""

import pytest

from panoloc.core.errors import PanoramaDamagedError, PanoramaShapeError
from panoloc.core.image.image_header import IMAGE, open_images
from panoloc.core.image.known_camera import check_known_cameras
from panoloc.core.image.reader import read_image
from panoloc.core.options import MAX_PIXELS
from tests.core.image.picture_files import encoded, gpano_packet, photo_file, picture

PHOTO = picture(160, 120)
_XMP = b"http://ns.adobe.com/xap/1.0/\x00"


def with_segment(jpeg: bytes, marker: int, content: bytes) -> bytes:
    """Put a segment behind the first two bytes of a JPEG."""
    return jpeg[:2] + bytes([0xFF, marker]) + (len(content) + 2).to_bytes(2, "big") + content + jpeg[2:]


PLAIN = encoded(PHOTO, "JPEG")
CROP = gpano_packet((640, 320), (100, 50), (160, 120))
TURNED = b'<x:xmpmeta><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
FILES = {
    "plain": PLAIN,
    "progressive": encoded(PHOTO, "JPEG", progressive=True),
    "commented": with_segment(PLAIN, 0xFE, b"taken by nobody"),
    "full sphere": encoded(picture(256, 128), "JPEG"),
    "focal length": photo_file(PHOTO, 26),
    "no focal length": photo_file(PHOTO, 0),
    "turned": photo_file(PHOTO, orientation=6),
    "turned by XMP": with_segment(PLAIN, 0xE1, _XMP + TURNED),
    "crop": with_segment(PLAIN, 0xE1, _XMP + CROP),
    "fill bytes": PLAIN[:2] + b"\xff" + PLAIN[2:],
    "png": encoded(PHOTO),
}
SAYS_ENOUGH = {"full sphere", "focal length", "crop", "png"}


def check(files: list[bytes]) -> None:
    check_known_cameras(open_images(files, IMAGE, MAX_PIXELS), files)


def refusal(name: str) -> str | None:
    """Return what the check says, None where it says nothing."""
    try:
        check([FILES[name]])
    except PanoramaShapeError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", FILES)
def test_what_is_refused_at_once_is_what_the_reader_refuses_in_the_same_words(name: str) -> None:
    said = refusal(name)
    assert (said is None) == (name in SAYS_ENOUGH)
    if said is not None:
        with pytest.raises(PanoramaShapeError) as error:
            read_image(FILES[name])
        assert str(error.value) == said


def test_the_number_of_the_image_is_said_where_there_are_several() -> None:
    with pytest.raises(PanoramaShapeError, match=r"160 x 120.*\(image 2 of 2\)$"):
        check([FILES["focal length"], PLAIN])


def test_no_damage_makes_it_fail_otherwise() -> None:
    refused = 0
    for end in range(2, len(PLAIN), 7):
        try:
            check([PLAIN[:end].ljust(len(PLAIN), b"\xff")])
        except (PanoramaDamagedError, PanoramaShapeError):
            refused += 1
    assert refused > 0
