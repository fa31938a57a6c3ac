"""Photos that nothing is known of are refused by their first bytes, and no photo that the reader would take."""

import pytest

from panoloc.core.errors import PanoramaFormatError, PanoramaShapeError
from panoloc.core.image.known_camera import check_known_cameras
from panoloc.core.image.reader import read_image
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
    "without pixels": PLAIN[: PLAIN.index(b"\xff\xda")],
}
REFUSED_AT_ONCE = {"plain", "progressive", "commented"}


def refusal(name: str) -> str | None:
    """Return what the check says, None where it says nothing."""
    try:
        check_known_cameras([FILES[name]])
    except PanoramaShapeError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", FILES)
def test_what_is_refused_at_once_is_what_the_reader_refuses_in_the_same_words(name: str) -> None:
    said = refusal(name)
    assert (said is not None) == (name in REFUSED_AT_ONCE)
    if said is not None:
        with pytest.raises(PanoramaShapeError) as error:
            read_image(FILES[name])
        assert str(error.value) == said


def test_the_number_of_the_image_is_said_where_there_are_several() -> None:
    with pytest.raises(PanoramaShapeError, match=r"160 x 120.*\(image 2 of 2\)$"):
        check_known_cameras([FILES["focal length"], PLAIN])


def test_no_damage_makes_it_fail_otherwise() -> None:
    refused = 0
    for end in range(2, len(PLAIN), 7):
        try:
            check_known_cameras([PLAIN[:end].ljust(len(PLAIN), b"\xff")])
        except (PanoramaFormatError, PanoramaShapeError):
            refused += 1
    assert refused > 0
