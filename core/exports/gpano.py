"""GPano: copies of the photos with their angles in XMP and their position in EXIF. All else in a JPEG stays as it is."""

import re
import struct
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from xml.etree import ElementTree

from panoloc.core.earth.geopose import EarthPose
from panoloc.core.exports.earth import on_earth
from panoloc.core.exports.exif_gps import MAX_SEGMENT_BYTES, GpsPosition, is_exif, with_position
from panoloc.core.exports.frames import PhotoAngles
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, plain, why_not_as_named

_GPANO = "http://ns.google.com/photos/1.0/panorama/"
_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_META = "adobe:ns:meta/"
_SIGNATURE = b"http://ns.adobe.com/xap/1.0/\x00"
_APP1, _APP0 = 0xE1, 0xE0
_OF_PLACE = re.compile(
    rf"\{{{re.escape(_GPANO)}\}}|\{{[^}}]*\}}(?i:gps)"
)  # GPano; EXIF in XMP and makers name fields GPS…
_BEGIN = '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'.encode()
_END = b'<?xpacket end="w"?>'


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can."""
    if photo.image is None:
        return "GPano is written into a copy of the photo, which no longer exists"
    if PurePosixPath(photo.name).suffix.lower() not in (".jpg", ".jpeg"):
        return "GPano is written only into JPEG files"
    return why_not_as_named(photo)


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield a copy of each JPEG, with the place in place of what its camera held for its own.

    Headings count from true north, elevation is up, roll is right side down. EXIF counts heights from sea level: without a geoid none is
    written.
    """
    for photo, place, angles in on_earth(tour):
        if photo.image is not None:
            position = GpsPosition(
                place.latitude_deg, place.longitude_deg, _above_sea_m(tour, place), angles.heading_deg
            )
            yield ExportedFile(photo.name, with_fields(photo.image.read_bytes(), _fields_of(photo, angles), position))


def _above_sea_m(tour: Tour, place: EarthPose) -> float | None:
    if place.height_reference == "geoid":
        return place.height_m
    if place.height_reference == "ellipsoid" and tour.geoid_undulation_m is not None:
        return place.height_m - tour.geoid_undulation_m
    return None


def _fields_of(photo: PlacedPhoto, angles: PhotoAngles) -> dict[str, str]:
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


def with_fields(jpeg: bytes, fields: Mapping[str, str], position: GpsPosition) -> bytes:
    """Return the JPEG with these GPano fields instead of its own, and with a position; other EXIF and XMP is kept where it can be read."""
    segments = list(_segments(jpeg))
    kept, exif = [], None
    for start, end in segments:
        if exif is None and jpeg[start + 1] == _APP1 and is_exif(jpeg[start + 4 : end]):
            exif = jpeg[start + 4 : end]
        elif not _is_xmp(jpeg, start):
            kept.append(jpeg[start:end])
    # JFIF comes first, then EXIF.
    num_first = sum(segment[1] == _APP0 for segment in kept)
    ours = [_app1(with_position(exif, position)), _app1(_xmp(fields, xmp_of(jpeg)))]
    end = segments[-1][1] if segments else 2
    return b"".join([jpeg[:2], *kept[:num_first], *ours, *kept[num_first:], jpeg[end:]])


def xmp_of(jpeg: bytes) -> bytes | None:
    """Return the XMP packet of a JPEG, None without one."""
    found = (jpeg[start + 4 + len(_SIGNATURE) : end] for start, end in _segments(jpeg) if _is_xmp(jpeg, start))
    return next(found, None)


def _segments(jpeg: bytes) -> Iterator[tuple[int, int]]:
    """Yield where each of the application segments begins and ends."""
    at = 2
    while at + 4 <= len(jpeg) and jpeg[at] == 0xFF and 0xE0 <= jpeg[at + 1] <= 0xEF:
        end = at + 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
        yield at, end
        at = end


def _is_xmp(jpeg: bytes, at: int) -> bool:
    return jpeg[at + 1] == _APP1 and jpeg.startswith(_SIGNATURE, at + 4)


def _app1(payload: bytes) -> bytes:
    return bytes([0xFF, _APP1]) + struct.pack(">H", len(payload) + 2) + payload


def _xmp(fields: Mapping[str, str], former: bytes | None) -> bytes:
    """Return the content of a segment. The former packet is left out where it is no XMP or does not fit beside the new fields."""
    for packet in (former, None):
        payload = _SIGNATURE + _BEGIN + _packet(fields, packet) + _END
        if len(payload) <= MAX_SEGMENT_BYTES:
            break
    return payload


def _packet(fields: Mapping[str, str], former: bytes | None) -> bytes:
    ElementTree.register_namespace("x", _META)
    ElementTree.register_namespace("rdf", _RDF)
    ElementTree.register_namespace("GPano", _GPANO)
    root = _parsed(former)
    descriptions = root.find(f"{{{_RDF}}}RDF")
    if descriptions is None:
        root = ElementTree.Element(f"{{{_META}}}xmpmeta")
        descriptions = ElementTree.SubElement(root, f"{{{_RDF}}}RDF")
    for description in descriptions:
        _forget_place(description)
    attributes = {f"{{{_RDF}}}about": "", **{f"{{{_GPANO}}}{name}": value for name, value in fields.items()}}
    ElementTree.SubElement(descriptions, f"{{{_RDF}}}Description", attributes)
    return bytes(ElementTree.tostring(root, "utf-8"))


def _parsed(packet: bytes | None) -> ElementTree.Element:
    """Return the packet, empty where it is none. Entities, which could grow without limit, make it none."""
    if packet is not None and b"<!" not in packet:
        try:
            return ElementTree.fromstring(packet.strip(b"\x00 \r\n\t"))
        except ElementTree.ParseError:
            pass
    return ElementTree.Element(f"{{{_META}}}xmpmeta")


def _forget_place(description: ElementTree.Element) -> None:
    """Take out what a camera held for its place and pose."""
    for name in [name for name in description.attrib if _OF_PLACE.match(name)]:
        del description.attrib[name]
    for child in [child for child in description if _OF_PLACE.match(child.tag)]:
        description.remove(child)
