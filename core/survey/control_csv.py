"""Control points from a CSV as surveyors write them: with or without a header, any usual delimiter, decimal points or commas."""

import csv
import math
import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from panoloc.core.errors import OptionsError

Vector = tuple[float, float, float]
MOST_POINTS = 1000
_MOST_FAULTS = 5
_NAMES = {
    "name": (
        "name",
        "id",
        "nr",
        "no",
        "number",
        "point",
        "pointid",
        "pointname",
        "punkt",
        "punktnummer",
        "pktnr",
        "label",
        "pt",
    ),
    "x": ("x", "e", "east", "easting", "rechtswert", "ost", "knownx"),
    "y": ("y", "n", "north", "northing", "hochwert", "nord", "knowny"),
    "z": ("z", "h", "height", "elevation", "elev", "alt", "altitude", "hohe", "hoehe", "knownz", "hae", "heightm"),
    "latitude": ("lat", "latitude", "latitudedeg", "breite", "phi"),
    "longitude": ("lon", "lng", "long", "longitude", "longitudedeg", "lange", "laenge", "lambda"),
    "map_x": ("mapx", "scanx", "measuredx"),
    "map_y": ("mapy", "scany", "measuredy"),
    "map_z": ("mapz", "scanz", "measuredz"),
}
_COLUMN_OF = {alias: column for column, aliases in _NAMES.items() for alias in aliases}
_GRID, _EARTH, _MAP = ("x", "y", "z"), ("latitude", "longitude", "z"), ("map_x", "map_y", "map_z")
_WANTED = (
    "name, x, y, z, or name, lat, lon, height; and map_x, map_y, map_z where the places in the scan are known already"
)


@dataclass(frozen=True)
class ControlPoint:
    """A point whose coordinates are known.

    known: east, north and height, metres, in the coordinate system of the points; or, where `is_geodetic`, latitude and longitude in
    degrees (WGS 84) and the height above the ellipsoid. position_m: where it is in the map, in its own frame; None while nobody has said.
    """

    name: str
    known: Vector
    is_geodetic: bool = False
    position_m: Vector | None = None


def read_control_points(text: str) -> list[ControlPoint]:
    """Return the points of a CSV, in their order. Raises OptionsError that names the lines at fault and what is wrong with each."""
    lines = [
        (number, line) for number, line in enumerate(text.lstrip("\ufeff").splitlines(), 1) if _says_something(line)
    ]
    if not lines:
        raise OptionsError(f"csv: expected lines with control points ({_WANTED}), got none")
    delimiter = _delimiter_of([line for _, line in lines])
    rows = [(number, [cell.strip() for cell in _cells(line, delimiter)]) for number, line in lines]
    columns = _header(rows[0][1])
    if columns is None:
        columns = ["name", *_GRID, *_MAP][: max(len(row) for _, row in rows)]
    else:
        rows = rows[1:]
    missing = _missing(columns)
    if missing:
        raise OptionsError(f"csv: expected the columns {_WANTED}; the file has no {missing}")
    if len(rows) > MOST_POINTS:
        raise OptionsError(f"csv: expected at most {MOST_POINTS} points, got {len(rows)}; send those that are needed")
    faults, points = list[str](), dict[str, ControlPoint]()
    for number, row in rows:
        try:
            point = _point(dict(zip(columns, row, strict=False)), delimiter)
            if point.name in points:
                raise ValueError(f"expected each name once, got {point.name!r} again; rename one of them")
            points[point.name] = point
        except ValueError as error:
            faults.append(f"line {number}: {error}")
    if faults:
        more = f"; and {len(faults) - _MOST_FAULTS} more lines" if len(faults) > _MOST_FAULTS else ""
        raise OptionsError(f"csv: {'; '.join(faults[:_MOST_FAULTS])}{more}")
    if not points:
        raise OptionsError(f"csv: expected lines with control points below the header ({_WANTED}), got none")
    return list(points.values())


def _says_something(line: str) -> bool:
    return bool(line.strip(' \t,;"')) and not line.lstrip().startswith("#")


def _delimiter_of(lines: Sequence[str]) -> str:
    """Return what separates the cells; a comma beside semicolons or tabs is that of decimals."""
    return next((each for each in (";", "\t") if all(each in line for line in lines)), "," if "," in lines[0] else " ")


def _cells(line: str, delimiter: str) -> Sequence[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter))


def _header(cells: Sequence[str]) -> list[str] | None:
    """Return the columns that a header names, "" for others; None where the first line is a point."""
    columns = [_COLUMN_OF.get(_plain(cell), "") for cell in cells]
    # Of a line of numbers only the name can look like a heading.
    has_numbers = any(char.isdigit() for cell in cells[1:] for char in cell)
    return columns if any(columns[1:]) or columns[:1] == ["x"] or not has_numbers else None


def _plain(cell: str) -> str:
    """Return a heading without units, accents and punctuation: "Höhe [m]" is "hohe"."""
    bare = re.sub(r"[\[(].*?[\])]", "", unicodedata.normalize("NFKD", cell))
    return re.sub(r"[^a-z]", "", bare.lower())


def _missing(columns: Sequence[str]) -> str:
    wanted = _EARTH if "latitude" in columns or "longitude" in columns else _GRID
    some_of_map = _MAP if any(each in columns for each in _MAP) else ()
    return ", ".join(each for each in ("name", *wanted, *some_of_map) if each not in columns)


def _point(cells: dict[str, str], delimiter: str) -> ControlPoint:
    """Return the point of a line. Raises ValueError."""
    is_geodetic = "latitude" in cells
    name = cells.get("name", "")
    if not name or len(name) > 80 or not name.isprintable():
        raise ValueError(f"expected a name of 1 to 80 printable characters, got {name[:20]!r}")
    known = _vector(cells, _EARTH if is_geodetic else _GRID, delimiter)
    if is_geodetic and not (abs(known[0]) <= 90 and abs(known[1]) <= 180):
        raise ValueError(
            f"expected a latitude up to 90 and a longitude up to 180 degrees, got {known[0]:g} and {known[1]:g}"
        )
    at = _vector(cells, _MAP, delimiter) if any(cells.get(each) for each in _MAP) else None
    return ControlPoint(name, known, is_geodetic, at)


def _vector(cells: dict[str, str], columns: Sequence[str], delimiter: str) -> Vector:
    x, y, z = _numbers(cells, columns, delimiter)
    return x, y, z


def _numbers(cells: dict[str, str], columns: Sequence[str], delimiter: str) -> Iterator[float]:
    for column in columns:
        text = cells.get(column, "")
        plain = text.replace(",", ".") if delimiter != "," else text
        try:
            value = float(plain)
        except ValueError:
            got = repr(text[:30]) if text else "nothing"
            raise ValueError(f"expected a number for {column.replace('_', ' ')}, got {got}") from None
        if not math.isfinite(value) or abs(value) > 1e8:
            raise ValueError(f"expected a number of metres for {column.replace('_', ' ')}, got {text[:30]!r}")
        yield value
