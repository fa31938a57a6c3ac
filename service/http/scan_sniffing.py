"""The cheap checks of a scan, while it is uploaded: is it a scan at all, and does a PLY keep what its header says?

Readers on the worker's side check everything again and more; what is refused here is refused at once.
"""

import re
from pathlib import Path, PurePosixPath

from service.errors import DamagedScanError, TooManyPointsError, UnknownScanError

HEAD_BYTES = 4096
KNOWN_FORMATS = "PLY, PCD, LAS, LAZ, E57, XYZ, TXT, CSV or PTS"

_BINARY_MAGIC = (b"ASTM-E57", b"LASF")
_EXTENSIONS_WITH_MAGIC = frozenset({".ply", ".pcd", ".las", ".laz", ".e57"})
_OTHER_MAGIC = {
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"RIFF": "a RIFF file (WebP image, sound or video)",
    b"GIF8": "a GIF image",
    b"PK\x03\x04": "a ZIP archive, which has to be unpacked first",
    b"\x1f\x8b": "a gzip archive, which has to be unpacked first",
    b"7z\xbc\xaf": "a 7z archive, which has to be unpacked first",
    b"%PDF": "a PDF document",
    b"glTF": "a glTF model, which has to be exported as a coloured PLY",
}
_PLY_HEADER_BYTES = 2**16
_PLY_SCALAR_BYTES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}


def check_scan_head(head: bytes, name: str) -> None:
    """Look at the first `HEAD_BYTES` of an upload. Raises DamagedScanError or UnknownScanError (the message says why)."""
    if not head:
        raise DamagedScanError(f"expected a scan as {KNOWN_FORMATS}, got an empty file (0 bytes); upload it again")
    if head.startswith((b"ply\n", b"ply\r", b"ply ", *_BINARY_MAGIC)) or _is_pcd(head):
        return
    found = next((what for magic, what in _OTHER_MAGIC.items() if head.startswith(magic)), None)
    if found is None and not _is_text(head):
        found = f"unknown binary data (first bytes: {head[:8].hex(' ')})"
    extension = scan_extension(name)
    if found is None and extension in _EXTENSIONS_WITH_MAGIC:
        found = f"a file named {extension} that does not begin like one"
    if found is not None:
        raise UnknownScanError(f"expected a scan as {KNOWN_FORMATS}, got {found}; export the scan in one of them")


def check_scan_file(path: Path, max_points: int) -> None:
    """Hold a binary PLY against its own header; other formats pass.

    Raises DamagedScanError for a file that ends before its last vertex, TooManyPointsError for more than `max_points`.
    """
    with path.open("rb") as stream:
        head = stream.read(_PLY_HEADER_BYTES)
    end = re.search(rb"^end_header\r?\n", head, re.MULTILINE)
    if not head.startswith(b"ply") or end is None:
        return
    header = head[: end.start()]
    text = header.decode("ascii", errors="replace")
    declared = re.search(r"^element +vertex +(\d{1,18})\s*$", text, re.MULTILINE)
    if declared is None:
        return
    num_points = int(declared[1])
    if num_points > max_points:
        raise TooManyPointsError(
            f"expected at most {max_points:,} points (PANOLOC_MAX_POINTS), got {num_points:,} by the file's header; "
            "thin the scan before uploading it"
        )
    stride = _binary_vertex_bytes(text)
    found = path.stat().st_size - end.end()
    if stride is not None and found < num_points * stride:
        raise DamagedScanError(
            f"expected {num_points:,} points of {stride} bytes by the file's header, got {found:,} bytes, which is "
            f"{found // stride:,} points: the file is cut off; upload or export it again"
        )


def scan_extension(name: str) -> str:
    """Return the extension of a file's name in lower case with its dot, empty when it has none of the usual form."""
    suffix = PurePosixPath(name.replace("\\", "/")).suffix.lower()
    return suffix if re.fullmatch(r"\.[a-z0-9]{1,10}", suffix) else ""


def _binary_vertex_bytes(header: str) -> int | None:
    """Return the bytes of a vertex of a binary PLY whose vertices come first and have no lists, else None."""
    lines = [line.split() for line in header.splitlines()]
    elements = [number for number, words in enumerate(lines) if words[:1] == ["element"]]
    is_binary = any(words[:1] == ["format"] and words[1:2] != ["ascii"] for words in lines)
    if not is_binary or not elements or lines[elements[0]][1:2] != ["vertex"]:
        return None
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = [words for words in lines[elements[0] : end] if words[:1] == ["property"]]
    sizes = [_PLY_SCALAR_BYTES.get(words[1]) if len(words) == 3 else None for words in properties]
    known = [size for size in sizes if size is not None]
    return sum(known) if known and len(known) == len(sizes) else None


def _is_pcd(head: bytes) -> bool:
    first_words = [line.split()[:1] for line in head[:1024].splitlines() if not line.startswith(b"#")]
    return b".PCD" in head[:64] or first_words[:2] == [[b"VERSION"], [b"FIELDS"]]


def _is_text(head: bytes) -> bool:
    printable = sum(byte >= 32 or byte in b"\t\n\r\v\f" for byte in head)
    return b"\x00" not in head and printable >= 0.99 * len(head)
