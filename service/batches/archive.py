"""Images of an upload: out of a zip, within limits that hold while it inflates, and their names."""

import hashlib
import re
import uuid
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from panoloc.core.scan.file_names import distinct_names
from panoloc.core.scan.zip_opening import is_encrypted, is_link, leads_out, open_zip
from panoloc.service.errors import ArchiveError, UploadTooLargeError

IMAGE_ENDINGS = frozenset({".jpg", ".jpeg", ".png", ".webp", ".heic", ".heif", ".hif", ".avif"})
_BLOCK_BYTES = 2**20
_MAX_ENTRIES = 20_000
_LONGEST_NAME = 200


@dataclass(frozen=True)
class UnpackedImage:
    """name: in the archive. path: where it is now. sha256: hexadecimal."""

    name: str
    path: Path
    sha256: str


def unpack_images(
    archive: Path, folder: Path, max_images: int, max_image_bytes: int, max_total_bytes: int
) -> tuple[list[UnpackedImage], list[str]]:
    """Return the images of a zip in its order, and the names of the files that are no images by their endings.

    max_image_bytes: of one, max_total_bytes: of all, both unpacked. Raises UploadTooLargeError, and ArchiveError for what is no zip, is
    damaged, encrypted, or names files outside of itself; nothing stays in the folder then.
    """
    unpacked: list[UnpackedImage] = []
    try:
        with open_zip(archive) as opened:
            images, ignored = _sorted_entries(opened, max_images)
            left = max_total_bytes
            for entry in images:
                target = folder / uuid.uuid4().hex
                unpacked.append(UnpackedImage(entry.filename, target, ""))
                digest, num_bytes = _unpack(opened, entry, target, max_image_bytes, left)
                unpacked[-1] = UnpackedImage(entry.filename, target, digest)
                left -= num_bytes
        return unpacked, ignored
    except BaseException as error:
        for image in unpacked:
            image.path.unlink(missing_ok=True)
        if isinstance(error, zipfile.BadZipFile | zlib.error | EOFError | NotImplementedError | ValueError):
            raise ArchiveError(f"archive: expected a zip, but {error}; pack the images again") from error
        raise


def unique_names(given: Iterable[str]) -> list[str]:
    """Return a printable path inside its folder for each name, in order; the second of a name becomes `name-2`."""
    return distinct_names(map(_clean, given))


def _sorted_entries(opened: zipfile.ZipFile, max_images: int) -> tuple[list[zipfile.ZipInfo], list[str]]:
    entries = [entry for entry in opened.infolist() if not entry.is_dir()]
    if len(entries) > _MAX_ENTRIES:
        raise UploadTooLargeError(
            f"archive: expected at most {_MAX_ENTRIES:,} files, got {len(entries):,}; pack the images alone"
        )
    for entry in entries:
        named = repr(entry.filename[:80])
        for is_wrong, expected, got in (
            (
                leads_out(entry.filename),
                "paths inside the zip",
                f"{named}, which leads out of it; pack the images again",
            ),
            (is_link(entry), "files", f"a link, {named}; pack the images themselves"),
            (is_encrypted(entry), "files without encryption", f"{named} encrypted; pack the images without a password"),
        ):
            if is_wrong:
                raise ArchiveError(f"archive: expected {expected}, got {got}")
    images = [entry for entry in entries if _is_image(entry.filename)]
    if len(images) > max_images:
        raise UploadTooLargeError(
            f"archive: expected at most {max_images:,} images (PANOLOC_MAX_BATCH_IMAGES), got {len(images):,}; "
            "send several batches"
        )
    return images, [entry.filename for entry in entries if not _is_image(entry.filename)]


def _is_image(name: str) -> bool:
    """Tell by its name whether a file is an image; hidden files of systems are none."""
    path = PurePosixPath(name)
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in path.parts)
    return path.suffix.lower() in IMAGE_ENDINGS and not hidden


def _unpack(
    opened: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path, max_bytes: int, left: int
) -> tuple[str, int]:
    """Write one file; counts the bytes that come, not those that are announced. left: of all files together."""
    digest, num_bytes = hashlib.sha256(), 0
    with opened.open(entry) as source, target.open("wb") as sink:
        while block := source.read(_BLOCK_BYTES):
            num_bytes += len(block)
            if num_bytes > max_bytes:
                raise UploadTooLargeError(
                    f"archive: expected {entry.filename[:80]!r} to unpack to at most {max_bytes:,} bytes "
                    "(PANOLOC_MAX_IMAGE_BYTES), got more; send smaller images"
                )
            if num_bytes > left:
                raise UploadTooLargeError(
                    f"archive: expected the images of a batch to unpack to fewer bytes together, "
                    f"of which {left:,} are left for {entry.filename[:80]!r}, got more; send several batches"
                )
            digest.update(block)
            sink.write(block)
    return digest.hexdigest(), num_bytes


def _clean(name: str) -> str:
    printable = re.sub(r"[\x00-\x1f\x7f]", "", name).replace("\\", "/")
    # Cut before the parts are looked at: what is left of `photos..` could be `..`.
    parts = [part.strip() for part in printable[-_LONGEST_NAME:].split("/")]
    return "/".join(part for part in parts if part not in ("", ".", "..")) or "image"
