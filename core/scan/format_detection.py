"""Which scan format a file has: its first bytes decide, its name is the second sign. Needs no numpy."""

import re
from pathlib import Path, PurePosixPath

from panoloc.core.errors import ScanDamagedError, ScanFormatError

HEAD_BYTES = 4096
_SCAN_MAGIC = {b"ASTM-E57": "e57", b"LASF": "las", b"glTF": "gltf", b"PK\x03\x04": "zip", b"PK\x05\x06": "zip"}
_GLTF_KEYS = (b'"asset"', b'"accessors"', b'"buffers"', b'"bufferViews"', b'"scenes"', b'"meshes"', b'"extensionsUsed"')
_OBJ_WORDS = {b"v", b"vt", b"vn", b"vp", b"f", b"l", b"p", b"o", b"g", b"s", b"mtllib", b"usemtl"}
PTX_HEADER = [1, 1, 3, 3, 3, 3, 4, 4, 4, 4]
"""Numbers on each line before the points: columns, rows, position and axes of the scanner, the matrix of its pose."""
_EXTENSION_FORMATS = {
    **{name: name for name in ("ply", "pcd", "las", "e57", "ptx", "gltf", "obj", "zip")},
    "laz": "las",
    "glb": "gltf",
    **dict.fromkeys(("xyz", "txt", "csv", "pts", "asc", "xyzrgb", "neu"), "text"),
}
_OTHER_MAGIC = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"RIFF": "a RIFF file (WebP image, sound or video)",
    b"GIF8": "a GIF image",
    b"\x1f\x8b": "a gzip archive: unpack it first and upload the content",
    b"7z\xbc\xaf": "a 7z archive: unpack it first and upload the content",
    b"%PDF": "a PDF document",
    b"\xd0\xcf\x11\xe0": "an Office document",
    b"MZ": "a program",
    b"\x7fELF": "a program",
}
KNOWN_FORMATS = "PLY, PCD, LAS, LAZ, E57, PTX, GLB, glTF, OBJ, XYZ, TXT, CSV, ASC or PTS, or a zip of them"


def detect_format(path: Path, extension: str | None) -> tuple[str, str | None]:
    """Return what `format_of` says of a file. extension: used when `path` has none, with or without its dot."""
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    return format_of(head, path.suffix or extension or "")


def format_of(head: bytes, extension: str) -> tuple[str, str | None]:
    """Return the format ("ply", "pcd", "las", "e57", "ptx", "gltf", "obj", "zip" or "text"), and a remark when the name differs.

    head: the first HEAD_BYTES of the file. extension: with or without its dot, or empty.

    Raises ScanFormatError when the content is of no known format or contradicts the name without a way to tell who is
    right; ScanDamagedError for an empty file.
    """
    if not head:
        raise ScanDamagedError(
            f"expected a scan as {KNOWN_FORMATS}, got a file that is empty (0 bytes); upload it again"
        )
    named = extension.lower().lstrip(".")[:20]
    expected = _EXTENSION_FORMATS.get(named)
    found = _format_by_magic(head)
    if found is None:
        return _text_format(head, named, expected), None
    if named and expected != found:
        return found, f"The file is named .{named}, but its content is {found.upper()}; it was read as {found.upper()}."
    return found, None


def extension_of(name: str) -> str:
    """Return the extension of a file's name in lower case with its dot, empty when it has none of the usual form."""
    suffix = PurePosixPath(name.replace("\\", "/")).suffix.lower()
    return suffix if re.fullmatch(r"\.[a-z0-9]{1,10}", suffix) else ""


def is_named_like_a_scan(name: str) -> bool:
    """Tell whether a file's extension is used for scans alone."""
    extension = extension_of(name).lstrip(".")
    return _EXTENSION_FORMATS.get(extension, "text") != "text" or extension in ("xyz", "pts")


def _format_by_magic(head: bytes) -> str | None:
    if head[:3] == b"ply" and head[3:4] in (b"\n", b"\r", b" ", b"\t"):
        return "ply"
    for magic, name in _SCAN_MAGIC.items():
        if head.startswith(magic):
            return name
    first_words = [line.split()[:1] for line in head[:1024].splitlines() if not line.startswith(b"#")]
    if b".PCD" in head[:64] or first_words[:2] == [[b"VERSION"], [b"FIELDS"]]:
        return "pcd"
    if _is_ptx(head):
        return "ptx"
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{") and any(key in head for key in _GLTF_KEYS):
        return "gltf"
    return "obj" if _is_obj(head) else None


def _is_ptx(head: bytes) -> bool:
    """A station begins with its counts, its axes and its matrix, line by line."""
    lines = [words for words in (line.split() for line in head.splitlines()) if words][: len(PTX_HEADER)]
    return [len(words) for words in lines] == PTX_HEADER and all(word.isdigit() for word in (*lines[0], *lines[1]))


def _is_obj(head: bytes) -> bool:
    """Every line begins with one of a few words; the last one may be cut."""
    words = [line.split(maxsplit=1)[0] for line in head.splitlines()[:-1] if line.strip() and not line.startswith(b"#")]
    return bool(words) and _OBJ_WORDS.issuperset(words)


def _text_format(head: bytes, named: str, expected: str | None) -> str:
    other = next((name for magic, name in _OTHER_MAGIC.items() if head.startswith(magic)), None)
    printable = sum(byte >= 32 or byte in b"\t\n\r\v\f" for byte in head)
    if other is None and b"\x00" not in head and printable >= 0.99 * len(head):
        if expected in (None, "text", "obj"):  # an OBJ may begin with a long comment
            return expected or "text"
        raise ScanFormatError(
            f"expected a scan as {KNOWN_FORMATS}, got a file named .{named} without that format's header: its "
            "content is plain text; give it the extension of its real format or export it again"
        )
    found = other or f"unknown binary data (first bytes: {head[:8].hex(' ')})"
    claim = f"a file named .{named} that is " if expected else ""
    raise ScanFormatError(f"expected a scan as {KNOWN_FORMATS}, got {claim}{found}; export the scan in one of them")
