"""Zips of images: unpacked within limits, refused when they are more than images."""

import hashlib
import io
import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path

import pytest

from panoloc.service.batches.archive import UnpackLimits, unique_names, unpack_images
from panoloc.service.errors import ArchiveError, UploadTooLargeError

LIMITS = UnpackLimits(max_images=3, max_image_bytes=1000, max_total_bytes=1500)


def zip_of(folder: Path, **entries: bytes) -> Path:
    return zip_named(folder, {name.replace("__", "/") + ".jpg": data for name, data in entries.items()})


def zip_named(folder: Path, entries: dict[str, bytes]) -> Path:
    path = folder / "photos.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return path


def spool(folder: Path) -> Path:
    target = folder / "spool"
    target.mkdir()
    return target


def test_images_come_out_in_their_order_with_their_digests_and_the_rest_is_named(tmp_path: Path) -> None:
    entries = {
        "b/2.JPG": b"two",
        "a/1.png": b"one",
        "notes.txt": b"hello",
        "__MACOSX/a/._1.png": b"x",
        "a/.hidden.jpg": b"y",
    }
    images, ignored = unpack_images(zip_named(tmp_path, entries), spool(tmp_path), LIMITS)
    assert [image.name for image in images] == ["b/2.JPG", "a/1.png"]
    assert [image.path.read_bytes() for image in images] == [b"two", b"one"]
    assert [image.sha256 for image in images] == [hashlib.sha256(data).hexdigest() for data in (b"two", b"one")]
    assert ignored == ["notes.txt", "__MACOSX/a/._1.png", "a/.hidden.jpg"]


@pytest.mark.parametrize(
    "name", ["../up.jpg", "a/../../up.jpg", "/etc/up.jpg", "..\\up.jpg", "C:\\up.jpg", "../notes.txt"]
)
def test_a_name_that_leads_out_of_the_archive_is_refused(name: str, tmp_path: Path) -> None:
    folder = spool(tmp_path)
    with pytest.raises(ArchiveError, match="leads out"):
        unpack_images(zip_named(tmp_path, {"a.jpg": b"1", name: b"2"}), folder, LIMITS)
    assert list(folder.iterdir()) == []


def test_a_bomb_is_refused_after_as_many_bytes_as_are_allowed_whatever_it_says_of_itself(tmp_path: Path) -> None:
    path = zip_of(tmp_path, good=b"fine", bomb=b"\0" * 50_000_000)
    assert path.stat().st_size < 60_000
    data = path.read_bytes()
    # In the directory the bomb now claims to hold ten bytes.
    at = data.rindex(b"PK\x01\x02")
    path.write_bytes(data[: at + 24] + (10).to_bytes(4, "little") + data[at + 28 :])
    folder = spool(tmp_path)
    with pytest.raises((UploadTooLargeError, ArchiveError)):
        unpack_images(path, folder, LIMITS)
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("entries", "limit"),
    [
        ({"a": b"1" * 1001}, r"1,000 bytes \(PANOLOC_MAX_IMAGE_BYTES\)"),
        ({"a": b"1" * 900, "b": b"2" * 900}, "of which 600 are left for 'b"),
        ({"a": b"1", "b": b"2", "c": b"3", "d": b"4"}, "PANOLOC_MAX_BATCH_IMAGES"),
    ],
)
def test_limits_hold_for_one_image_for_all_bytes_and_for_their_number(
    entries: dict[str, bytes], limit: str, tmp_path: Path
) -> None:
    folder = spool(tmp_path)
    with pytest.raises(UploadTooLargeError, match=limit):
        unpack_images(zip_of(tmp_path, **entries), folder, LIMITS)
    assert list(folder.iterdir()) == []


def link() -> bytes:
    entry = zipfile.ZipInfo("link.jpg")
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return packed({entry: b"/etc/passwd"})


def encrypted() -> bytes:
    data = bytearray(packed({"a.jpg": b"original"}))
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        data[data.index(mark) + flags] |= 1
    return bytes(data)


def packed(entries: Mapping[str | zipfile.ZipInfo, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return out.getvalue()


WHOLE = packed({"a.jpg": b"1" * 900, "b.jpg": b"2" * 100})


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (link(), "link"),
        (encrypted(), "encrypted"),
        (packed({"a.jpg": b"original"}).replace(b"original", b"0riginal"), "CRC"),
        *((WHOLE[: int(share * len(WHOLE))], "expected a zip") for share in (0.2, 0.6, 0.95)),
    ],
)
def test_what_is_no_whole_zip_of_files_is_refused(data: bytes, reason: str, tmp_path: Path) -> None:
    (path := tmp_path / "photos.zip").write_bytes(data)
    folder = spool(tmp_path)
    with pytest.raises(ArchiveError, match=reason):
        unpack_images(path, folder, LIMITS)
    assert list(folder.iterdir()) == []


def test_names_are_printable_inside_of_their_folder_and_each_once() -> None:
    given = [
        "a.jpg",
        "a.jpg",
        "x/a.jpg",
        "../up.jpg",
        "/etc/b.jpg",
        "c\\d.jpg",
        "new\nline.jpg",
        "",
        "a.jpg",
        "ä ö.jpg",
    ]
    assert unique_names(given) == [
        "a.jpg",
        "a-2.jpg",
        "x/a.jpg",
        "up.jpg",
        "etc/b.jpg",
        "c/d.jpg",
        "newline.jpg",
        "image",
        "a-3.jpg",
        "ä ö.jpg",
    ]
    long = "x" * 300 + ".jpg"
    assert len(unique_names([long])[0]) == 200
    assert unique_names(["photos../" + "x" * 193 + ".jpg"]) == ["x" * 193 + ".jpg"]
    assert unique_names(["a-2.jpg", "a.jpg", "a.jpg"]) == ["a-2.jpg", "a.jpg", "a-3.jpg"]


@pytest.mark.parametrize("name", [".", "./"])
def test_a_name_that_is_no_name_is_no_image(name: str, tmp_path: Path) -> None:
    images, _ = unpack_images(zip_named(tmp_path, {"a.jpg": b"1", name: b""}), spool(tmp_path), LIMITS)
    assert [image.name for image in images] == ["a.jpg"]


def test_a_zip_whose_list_of_files_would_fill_the_memory_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("panoloc.core.zip_opening.MAX_LIST_BYTES", 1000)
    many = zip_named(tmp_path, {f"{number}.jpg": b"" for number in range(50)})
    with pytest.raises(ArchiveError, match=r"list of files takes .* pack fewer files"):
        unpack_images(many, spool(tmp_path), LIMITS)
