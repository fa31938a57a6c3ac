"""GPano: copies of the photos with their angles in XMP. Every other byte of a JPEG stays as it is."""

import struct
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from xml.etree import ElementTree

from panoloc.core.exports.earth import on_earth
from panoloc.core.exports.frames import PhotoAngles
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, plain, why_not_as_named

_GPANO = "http://ns.google.com/photos/1.0/panorama/"
_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_META = "adobe:ns:meta/"
_SIGNATURE = b"http://ns.adobe.com/xap/1.0/\x00"
_APP1, _APP0, _MAX_SEGMENT_BYTES = 0xE1, 0xE0, 65_533
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
    """Yield a copy of each JPEG. Headings count from true north, elevation is up, roll is right side down."""
    for photo, _, angles in on_earth(tour):
        if photo.image is not None:
            yield ExportedFile(photo.name, with_fields(photo.image.read_bytes(), _fields_of(photo, angles)))


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


def with_fields(jpeg: bytes, fields: Mapping[str, str]) -> bytes:
    """Return the JPEG with these GPano fields instead of its own; other XMP is kept where it can be read."""
    kept, insert_at, end = bytearray(jpeg[:2]), 2, 2
    for start, end in _segments(jpeg):
        if not _is_xmp(jpeg, start):
            kept += jpeg[start:end]
        if jpeg[start + 1] in (_APP0, _APP1):
            insert_at = len(kept)  # JFIF and EXIF want to come first
    return bytes(kept[:insert_at]) + _segment(fields, xmp_of(jpeg)) + bytes(kept[insert_at:]) + jpeg[end:]


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


def _segment(fields: Mapping[str, str], former: bytes | None) -> bytes:
    """Return an APP1 segment. The former packet is left out where it is no XMP or does not fit beside the new fields."""
    for packet in (former, None):
        payload = _SIGNATURE + _BEGIN + _packet(fields, packet) + _END
        if len(payload) <= _MAX_SEGMENT_BYTES:
            break
    return bytes([0xFF, _APP1]) + struct.pack(">H", len(payload) + 2) + payload


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
        _forget_gpano(description)
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


def _forget_gpano(description: ElementTree.Element) -> None:
    for name in [name for name in description.attrib if name.startswith(f"{{{_GPANO}}}")]:
        del description.attrib[name]
    for child in [child for child in description if child.tag.startswith(f"{{{_GPANO}}}")]:
        description.remove(child)
