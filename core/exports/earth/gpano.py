"""GPano: copies of the photos with their angles in XMP, pixels untouched."""

from collections.abc import Iterator
from pathlib import PurePosixPath

from panoloc.core.exports.angles import PhotoAngles
from panoloc.core.exports.earth.jpeg_xmp import with_fields
from panoloc.core.exports.earth.placing import on_earth
from panoloc.core.exports.image_kind import why_not_as_named
from panoloc.core.exports.number_text import plain
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour

_ENDINGS = (".jpg", ".jpeg")


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can."""
    if photo.image is None:
        return "GPano is written into a copy of the photo, which no longer exists"
    if PurePosixPath(photo.name).suffix.lower() not in _ENDINGS:
        return "GPano is written only into JPEG files"
    return why_not_as_named(photo.name, photo.image)


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield a copy of each JPEG. Headings count from true north, elevation is up, roll is right side down."""
    for photo, _, angles in on_earth(tour):
        if photo.image is not None:
            yield ExportedFile(photo.name, with_fields(photo.image.read_bytes(), fields_of(photo, angles)))


def fields_of(photo: PlacedPhoto, angles: PhotoAngles) -> dict[str, str]:
    """Return the GPano fields of a full sphere."""
    width, height = str(photo.width), str(photo.height)
    return {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaImageWidthPixels": width,
        "CroppedAreaImageHeightPixels": height,
        "CroppedAreaLeftPixels": "0",
        "CroppedAreaTopPixels": "0",
        "PoseHeadingDegrees": plain(angles.heading_deg),
        "PosePitchDegrees": plain(angles.elevation_deg),
        "PoseRollDegrees": plain(angles.roll_deg),
    }
