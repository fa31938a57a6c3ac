"""GPano: copies of JPEGs with pose and position, in which all else is as it was."""

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from panoloc.core.exports.exif_gps import GpsPosition, with_position
from panoloc.core.exports.gpano import with_fields, xmp_of
from panoloc.core.exports.tour import Tour
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.known_camera import crop_fields
from tests.core.exports.tours import GOLDEN, golden_tour, jpeg, written

HERE = GpsPosition(47.7, -122.3, None, 37.5)
GPS, EXIF, MAKER_NOTE = 0x8825, 0x8769, 0x927C
BERLIN = {
    1: "N",
    2: (52.0, 30.0, 0.0),
    3: "E",
    4: (13.0, 24.0, 0.0),
    5: b"\x00",
    6: 34.0,
    7: (12.0, 30.0, 5.0),
    16: "M",
    17: 200.0,
    29: "2025:06:26",
}


def photo(folder: Path, exif: Image.Exif | None) -> Path:
    path = folder / "camera.jpg"
    Image.linear_gradient("L").resize((64, 32)).convert("RGB").save(path, exif=exif or Image.Exif())
    return path


def exported(path: Path, folder: Path, **changes: Any) -> Path:
    tour = golden_tour()
    tour = replace(tour, photos=(replace(tour.photos[0], image=path),))
    return written("gpano", replace(tour, **changes), folder) / "pano.jpg"


def gps_of(path: Path) -> dict[int, Any]:
    with Image.open(path) as image:
        return dict(image.getexif().get_ifd(GPS))


def place_of(gps: dict[int, Any]) -> tuple[float, float]:
    """Return latitude and longitude in degrees."""
    angles = [float(d) + float(m) / 60 + float(s) / 3600 for d, m, s in (gps[2], gps[4])]
    return angles[0] * (1 if gps[1] == "N" else -1), angles[1] * (1 if gps[3] == "E" else -1)


def with_berlin() -> Image.Exif:
    exif = Image.Exif()
    exif[0x010F] = "maker"
    exif[0x0112] = 1
    exif.get_ifd(EXIF).update({0x9003: "2025:06:26 14:30:05", MAKER_NOTE: b"notes of the maker " * 40})
    exif.get_ifd(GPS).update(BERLIN)
    return exif


@pytest.mark.parametrize("exif", [None, with_berlin()], ids=["without EXIF", "in Berlin"])
def test_a_photo_stands_where_it_was_placed_and_no_longer_where_its_camera_was_wrong(
    exif: Image.Exif | None, tmp_path: Path
) -> None:
    after = exported(photo(tmp_path, exif), tmp_path / "out")
    gps = gps_of(after)
    assert place_of(gps) == pytest.approx((47.699977515, -122.299983346), abs=2e-9)
    assert gps[16] == "T"
    assert float(gps[17]) == pytest.approx(37.5, abs=1e-3)
    assert 6 not in gps  # above the ellipsoid, which EXIF does not count from
    assert gps.get(7) == (BERLIN[7] if exif else None)
    old = b"\x34\x00\x00\x00\x01\x00\x00\x00\x1e\x00\x00\x00\x01\x00\x00\x00"  # 52/1, 30/1
    assert old not in after.read_bytes()
    assert old[::-1] not in after.read_bytes()


def test_everything_else_that_a_camera_wrote_stays_where_it_was(tmp_path: Path) -> None:
    path = photo(tmp_path, with_berlin())
    with Image.open(path) as old, Image.open(exported(path, tmp_path / "out")) as new:
        assert new.getexif()[0x010F] == "maker"
        assert new.getexif().get_ifd(EXIF) == old.getexif().get_ifd(EXIF)
        notes = b"notes of the maker " * 40
        assert new.info["exif"].index(notes) == old.info["exif"].index(notes)  # its offsets count from the beginning
        assert np.array_equal(np.asarray(old), np.asarray(new))


def test_heights_are_above_the_sea_where_that_is_known(tmp_path: Path) -> None:
    path = photo(tmp_path, with_berlin())
    gps = gps_of(exported(path, tmp_path / "above", geoid_undulation_m=-20.5))
    assert gps[5] == b"\x00"
    assert float(gps[6]) == pytest.approx(33.6, abs=1e-3)
    gps = gps_of(exported(path, tmp_path / "below", geoid_undulation_m=46.2))
    assert gps[5] == b"\x01"
    assert float(gps[6]) == pytest.approx(33.1, abs=1e-3)
    at = Pose(GOLDEN.rotation, np.array([291_250.25, 5_612_480.5, 212.75]))
    photo_there = replace(golden_tour().photos[0], map_from_camera=at, image=path)
    for system, height in (("EPSG:25832+7837", 212.75), ("EPSG:25832", None)):
        folder = written("gpano", Tour("map_1", (photo_there,), coordinate_system=system), tmp_path / system[-4:])
        gps = gps_of(folder / "pano.jpg")
        assert gps.get(6) == (None if height is None else pytest.approx(height, abs=1e-3))


def full_segment(of_thumbnail: bool) -> bytes:
    """Return EXIF of 64 KiB in which a camera says 52 degrees; most of it is a thumbnail, or else notes of its maker."""
    tables = 8 + 2 + 3 * 12 + 4, 8 + 2 + 3 * 12 + 4 + 30
    gps = struct.pack(">HHHI4sHHII", 2, 1, 2, 2, b"N", 2, 5, 3, 0) + bytes(4)
    values_at = tables[1] + len(gps)
    gps = gps.replace(struct.pack(">HHII", 2, 5, 3, 0), struct.pack(">HHII", 2, 5, 3, values_at))
    data_at = values_at + 24
    data = 65_533 - 6 - data_at
    first = struct.pack(">HHHII", 3, 0x0112, 3, 1, 1 << 16) + struct.pack(">HHII", GPS, 4, 1, tables[1])
    first += (
        struct.pack(">HHII", 0xC634, 7, data, data_at)
        if not of_thumbnail
        else struct.pack(">HHI4s", 0xC634, 7, 4, b"note")
    )
    first += struct.pack(">I", tables[0] if of_thumbnail else 0)
    second = struct.pack(">HHHIIHHIII", 2, 0x0201, 4, 1, data_at, 0x0202, 4, 1, data, 0)
    return (
        b"Exif\x00\x00MM\x00*\x00\x00\x00\x08"
        + first
        + second
        + gps
        + struct.pack(">6I", 52, 1, 30, 1, 0, 1)
        + bytes(data)
    )


def test_where_a_segment_is_full_its_thumbnail_makes_room(tmp_path: Path) -> None:
    found = Image.Exif()
    found.load(with_position(full_segment(of_thumbnail=True), HERE))
    assert place_of(dict(found.get_ifd(GPS))) == pytest.approx((47.7, -122.3))
    assert found[0xC634] == b"note"
    assert found.get_ifd(1) == {}


def test_where_even_that_makes_no_room_the_wrong_position_goes_all_the_same() -> None:
    before = full_segment(of_thumbnail=False)
    after, found = with_position(before, HERE), Image.Exif()
    found.load(after)
    assert (len(after), found[0x0112]) == (len(before), 1)
    assert found.get_ifd(GPS) == {}
    assert struct.pack(">4I", 52, 1, 30, 1) in before
    assert struct.pack(">4I", 52, 1, 30, 1) not in after


@pytest.mark.parametrize(
    "damaged", [b"Exif\x00\x00", b"Exif\x00\x00MM\x00*\x00\x00\xff\xff", b"Exif\x00\x00??" + bytes(50)]
)
def test_damaged_exif_is_replaced(damaged: bytes) -> None:
    found = Image.Exif()
    found.load(with_position(damaged, HERE))
    assert place_of(dict(found.get_ifd(GPS))) == pytest.approx((47.7, -122.3))


def test_gpano_leaves_every_pixel_and_all_other_data_as_they_were(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x010F] = "maker"
    path = tmp_path / "pano.jpg"
    with Image.open(golden_tour(tmp_path).photos[0].image) as image:  # type: ignore[arg-type]
        image.save(path, exif=exif, comment=b"a comment")
    before = path.read_bytes()
    tour = golden_tour()
    tour = replace(tour, photos=(replace(tour.photos[0], image=path),))
    after = written("gpano", tour, tmp_path / "out") / "pano.jpg"
    with Image.open(path) as old, Image.open(after) as new:
        assert np.array_equal(np.asarray(old), np.asarray(new))
        assert new.getexif()[0x010F] == "maker"
        assert new.info["comment"] == b"a comment"
        assert crop_fields(new, after.read_bytes()) is None  # a full sphere
    scan_at = before.index(b"\xff\xdb")
    assert after.read_bytes().endswith(before[scan_at:])


def test_gpano_replaces_what_a_camera_wrote_of_its_pose_and_keeps_the_rest_of_its_xmp() -> None:
    packet = (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        b'<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" xmlns:c="http://camera/" '
        b'GPano:PoseHeadingDegrees="12" c:Serial="77" c:GpsLatitude="52.25">'
        b"<c:GPSLongitude>13.5</c:GPSLongitude>"
        b'<e:GPSAltitude xmlns:e="http://ns.adobe.com/exif/1.0/">99/1</e:GPSAltitude>'
        b"<GPano:PoseRollDegrees>3</GPano:PoseRollDegrees></rdf:Description>"
        b"</rdf:RDF></x:xmpmeta>"
    )
    signature = b"http://ns.adobe.com/xap/1.0/\x00"
    segment = b"\xff\xe1" + (len(signature + packet) + 2).to_bytes(2, "big") + signature + packet
    source = jpeg()
    found = xmp_of(with_fields(source[:2] + segment + source[2:], {"PoseHeadingDegrees": "37.5"}, HERE))
    assert found is not None
    assert b'PoseHeadingDegrees="37.5"' in found
    assert b'"12"' not in found
    assert b"PoseRollDegrees" not in found
    assert b'Serial="77"' in found
    assert b"gps" not in found.lower()
    bomb = segment.replace(packet, b"<!DOCTYPE a [<!ENTITY b 'b'>]>" + packet[30:])
    assert b"DOCTYPE" not in (
        xmp_of(with_fields(source[:2] + bomb + source[2:], {"PoseHeadingDegrees": "1"}, HERE)) or b""
    )
