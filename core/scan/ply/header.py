"""The header of a PLY file: its elements, their properties, and the checks that need no data. Needs no numpy."""

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from panoloc.core.errors import CUT_SHORT, ScanDamagedError
from panoloc.core.options import ScanOptions

_MAX_HEADER_BYTES = 1 << 20
_MAX_ELEMENTS = 64
_MAX_PROPERTIES = 1024

POSITION_NAMES = ("x", "y", "z")
# Names of a type in the notation of numpy, without its byte order.
_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_COLOR_NAMES = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("scalar_red", "scalar_green", "scalar_blue"),
)
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class PlyProperty:
    """name: lower case. type: as numpy writes it, such as "<f4". count_type: type of a list's length, None for a scalar."""

    name: str
    type: str
    count_type: str | None = None

    @property
    def min_bytes(self) -> int:
        """Return the bytes that one value takes at least."""
        return int((self.count_type or self.type)[2])


@dataclass(frozen=True)
class PlyElement:
    """A table of the file: `count` rows of `properties`."""

    name: str
    count: int
    properties: tuple[PlyProperty, ...]

    @property
    def has_lists(self) -> bool:
        """Tell whether any property is a list, so that rows differ in size."""
        return len(self.scalars) < len(self.properties)

    @property
    def scalars(self) -> dict[str, str]:
        """Return the types of the properties of one value, by name."""
        return {prop.name: prop.type for prop in self.properties if prop.count_type is None}

    @property
    def color_names(self) -> tuple[str, str, str] | None:
        """Return the names of the properties that are colours, None without any."""
        return next((names for names in _COLOR_NAMES if self.scalars.keys() >= set(names)), None)


@dataclass(frozen=True)
class PlyHeader:
    """is_ascii: the data are text, one row a line. size_bytes, num_lines: where they begin."""

    is_ascii: bool
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...]
    size_bytes: int
    num_lines: int

    def element(self, name: str) -> PlyElement | None:
        """Return the element of that name, or None."""
        return next((element for element in self.elements if element.name == name), None)


def read_ply_header(stream: BinaryIO) -> PlyHeader:
    """Parse the header at the start of `stream`; raise ScanDamagedError when it contradicts itself."""
    lines, size_bytes = _header_lines(stream)
    encoding, comments = "", []
    tables: list[tuple[str, int, list[PlyProperty]]] = []
    for number, line in enumerate(lines, start=1):
        words = line.split()
        keyword = words[0] if words else ""
        if keyword in ("", "ply", "obj_info"):
            continue
        if keyword == "comment":
            comments.append(line.partition(" ")[2].strip())
        elif keyword == "format" and len(words) == 3 and words[1] in _BYTE_ORDERS and not encoding:
            encoding = words[1]
        elif keyword == "element" and len(words) == 3 and encoding:
            if not (words[2].isdecimal() and words[2].isascii() and len(words[2]) < 20):
                raise _header_error(f"the count in {line[:80]!r} is not a positive whole number")
            tables.append((words[1].lower(), int(words[2]), []))
        elif keyword == "property" and tables:
            _add_property(tables[-1][2], words, _BYTE_ORDERS[encoding], line)
        else:
            raise _header_error(f"line {number} is not understood: {line[:80]!r}")
    if not encoding:
        raise _header_error("there is no 'format ascii|binary_little_endian|binary_big_endian 1.0' line")
    if len({name for name, _, _ in tables}) < len(tables) or len(tables) > _MAX_ELEMENTS:
        raise _header_error("an element is declared twice, or there are too many elements")
    elements = tuple(PlyElement(name, count, tuple(properties)) for name, count, properties in tables)
    return PlyHeader(encoding == "ascii", elements, tuple(comments), size_bytes, len(lines) + 1)


def check_file_size(header: PlyHeader, size_bytes: int) -> str | None:
    """Raise ScanDamagedError when the file cannot hold what its header announces; say so when it holds more."""
    available = size_bytes - header.size_bytes
    needed = 0
    for element in header.elements:
        # At least; as text, a digit and what follows it per value, but for the last one of the file.
        row_bytes = sum(2 if header.is_ascii else prop.min_bytes for prop in element.properties)
        needed += max(element.count * row_bytes - int(header.is_ascii), 0)
        if needed > available:
            num_found = max(int(element.count - (needed - available) / row_bytes), 0)
            rows = "points" if element.name == "vertex" else f"rows of {element.name!r}"
            exact = "" if not header.is_ascii and not element.has_lists else "at least "
            raise ScanDamagedError(
                f"expected {element.count:,} {rows} of {exact}{row_bytes} bytes by the PLY header, got {available:,} bytes "
                f"of data, enough for {num_found:,}: the file is cut off. {CUT_SHORT}"
            )
    if not header.is_ascii and not any(element.has_lists for element in header.elements) and needed < available:
        return f"The file holds {available - needed:,} bytes more than its header announces; they were not read."
    return None


def check_ply_file(path: Path, options: ScanOptions) -> None:
    """Compare the size of a PLY file with its header, without reading the data. Other files and headers pass.

    Raises ScanTooLargeError and ScanDamagedError.
    """
    with path.open("rb") as stream:
        if stream.read(3) != b"ply":
            return
        stream.seek(0)
        try:
            header = read_ply_header(stream)
        except ScanDamagedError:
            return
    vertices = header.element("vertex")
    if vertices is not None:
        options.check_num_points(vertices.count)
    check_file_size(header, path.stat().st_size)


def _header_lines(stream: BinaryIO) -> tuple[list[str], int]:
    start = stream.read(_MAX_HEADER_BYTES)
    # The line end of the first line decides: after "end_header" a binary byte may look like one.
    newline = next((end for end in (b"\r\n", b"\n", b"\r") if start[3:16].lstrip(b" \t").startswith(end)), b"\n")
    lines: list[str] = []
    position = 0
    while (end := start.find(newline, position)) >= 0:
        line = start[position:end].decode("ascii", errors="replace").strip()
        position = end + len(newline)
        if line == "end_header":
            return lines, position
        lines.append(line)
    raise _header_error(f"no 'end_header' line within the first {len(start)} bytes")


def _add_property(properties: list[PlyProperty], words: list[str], byte_order: str, line: str) -> None:
    is_list = len(words) == 5 and words[1] == "list"
    types = words[2:4] if is_list else words[1:2]
    if len(words) != (5 if is_list else 3) or any(name not in _TYPES for name in types):
        raise _header_error(f"the property {line[:80]!r} has an unknown form or type")
    found = [byte_order + _TYPES[name] for name in types]
    if is_list and found[0][1] == "f":
        raise _header_error(f"the list length in {line[:80]!r} must be a whole number type")
    name = words[-1].lower()
    if any(prop.name == name for prop in properties):
        raise _header_error(f"the property {name[:80]!r} is declared twice in one element")
    if len(properties) >= _MAX_PROPERTIES:
        raise _header_error(f"an element has more than {_MAX_PROPERTIES} properties")
    properties.append(PlyProperty(name, found[-1], found[0] if is_list else None))


def _header_error(what: str) -> ScanDamagedError:
    return ScanDamagedError(f"The PLY header is damaged: {what}. Export the scan again.")
