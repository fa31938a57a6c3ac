"""Zips of images: unpacked within limits, refused when they are more than images."""

import hashlib
import io
import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from panoloc.service.batches.archive import UnpackedImage, unique_names, unpack_images
from panoloc.service.errors import ArchiveError, UploadTooLargeError

LIMITS = {"max_images": 3, "max_image_bytes": 1000, "max_total_bytes": 1500}


def packed(entries: Mapping[str | zipfile.ZipInfo, bytes], method: int = zipfile.ZIP_STORED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return out.getvalue()


def unpack(folder: Path, data: bytes) -> tuple[list[UnpackedImage], list[str]]:
    """Unpack a zip; where it is refused, check that nothing stays."""
    (archive := folder / "photos.zip").write_bytes(data)
    (spool := folder / "spool").mkdir()
    try:
        return unpack_images(archive, spool, **LIMITS)
    except (ArchiveError, UploadTooLargeError):
        assert list(spool.iterdir()) == []
        raise


def test_images_come_out_in_their_order_with_their_digests_and_the_rest_is_named(tmp_path: Path) -> None:
    entries: dict[str | zipfile.ZipInfo, bytes] = {
        "b/2.JPG": b"two",
        "a/1.png": b"one",
        "notes.txt": b"hello",
        "__MACOSX/a/._1.png": b"x",
        "a/.hidden.jpg": b"y",
    }
    images, ignored = unpack(tmp_path, packed(entries))
    assert [image.name for image in images] == ["b/2.JPG", "a/1.png"]
    assert [image.path.read_bytes() for image in images] == [b"two", b"one"]
    assert [image.sha256 for image in images] == [hashlib.sha256(data).hexdigest() for data in (b"two", b"one")]
    assert ignored == ["notes.txt", "__MACOSX/a/._1.png", "a/.hidden.jpg"]


def test_a_bomb_is_refused_after_as_many_bytes_as_are_allowed_whatever_it_says_of_itself(tmp_path: Path) -> None:
    data = packed({"good.jpg": b"fine", "bomb.jpg": b"\0" * 50_000_000}, zipfile.ZIP_DEFLATED)
    assert len(data) < 60_000
    # In the directory the bomb now claims to hold ten bytes.
    at = data.rindex(b"PK\x01\x02")
    with pytest.raises((UploadTooLargeError, ArchiveError)):
        unpack(tmp_path, data[: at + 24] + (10).to_bytes(4, "little") + data[at + 28 :])


@pytest.mark.parametrize(
    ("entries", "limit"),
    [
        ({"a.jpg": b"1" * 1001}, r"1,000 bytes \(PANOLOC_MAX_IMAGE_BYTES\)"),
        ({"a.jpg": b"1" * 900, "b.jpg": b"2" * 900}, "of which 600 are left for 'b"),
        ({f"{number}.jpg": b"1" for number in range(4)}, "PANOLOC_MAX_BATCH_IMAGES"),
    ],
)
def test_limits_hold_for_one_image_for_all_bytes_and_for_their_number(
    entries: dict[str | zipfile.ZipInfo, bytes], limit: str, tmp_path: Path
) -> None:
    with pytest.raises(UploadTooLargeError, match=limit):
        unpack(tmp_path, packed(entries))


def link() -> bytes:
    entry = zipfile.ZipInfo("link.jpg")
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return packed({entry: b"/etc/passwd"})


def encrypted() -> bytes:
    data = bytearray(packed({"a.jpg": b"original"}))
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + flags] |= 1
    return bytes(data)


WHOLE = packed({"a.jpg": b"1" * 900, "b.jpg": b"2" * 100})
OUTSIDE = ("../up.jpg", "a/../../up.jpg", "/etc/up.jpg", "..\\up.jpg", "C:\\up.jpg", "../notes.txt")


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        *((packed({"a.jpg": b"1", name: b"2"}), "leads out") for name in OUTSIDE),
        (link(), "link"),
        (encrypted(), "encrypted"),
        (packed({"a.jpg": b"original"}).replace(b"original", b"0riginal"), "CRC"),
        *((WHOLE[: int(share * len(WHOLE))], "expected a zip") for share in (0.2, 0.6, 0.95)),
    ],
)
def test_what_is_no_whole_zip_of_files_inside_is_refused(data: bytes, reason: str, tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match=reason):
        unpack(tmp_path, data)


def test_names_are_printable_inside_of_their_folder_and_each_once() -> None:
    expected = {
        "a.jpg": "a.jpg",
        "x/a.jpg": "x/a.jpg",
        "../up.jpg": "up.jpg",
        "/etc/b.jpg": "etc/b.jpg",
        "c\\d.jpg": "c/d.jpg",
        "new\nline.jpg": "newline.jpg",
        "": "image",
        "ä ö.jpg": "ä ö.jpg",
        "photos../" + "x" * 193 + ".jpg": "x" * 193 + ".jpg",
    }
    assert unique_names(expected) == list(expected.values())
    assert unique_names(["a-2.jpg", "a.jpg", "a.jpg"]) == ["a-2.jpg", "a.jpg", "a-3.jpg"]
    assert len(unique_names(["x" * 300 + ".jpg"])[0]) == 200


@pytest.mark.parametrize("name", [".", "./"])
def test_a_name_that_is_no_name_is_no_image(name: str, tmp_path: Path) -> None:
    images, _ = unpack(tmp_path, packed({"a.jpg": b"1", name: b""}))
    assert [image.name for image in images] == ["a.jpg"]


def test_a_zip_whose_list_of_files_would_fill_the_memory_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.core.scan.zip_opening.MAX_LIST_BYTES", 1000)
    with pytest.raises(ArchiveError, match=r"list of files takes .* pack fewer files"):
        unpack(tmp_path, packed({f"{number}.jpg": b"" for number in range(50)}))
