"""The lines of an OBJ file, gathered by what they say: vertices and faces become arrays, the rest stays text."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.errors import CUT_SHORT, ScanDamagedError, ScanTooLargeError
from core.scan.text.table import parse_numbers

_BLOCK_BYTES = 1 << 23
_LONGEST_LINE = 1 << 20
MAX_ROWS = 50_000_000
"""Of vertices, texture coordinates or faces."""


@dataclass
class ObjStatements:
    """vertices: (V, 3 or 6), colours behind the position. texture_coordinates: (U, 2). triangles, triangle_uv: (T, 3) numbers of both,
    −1 where a corner has no texture coordinate. materials: names in the order of their first use. triangle_materials: (T,) numbers
    of those, −1: none. libraries: files that describe them.
    """

    vertices: NDArray[np.float64]
    texture_coordinates: NDArray[np.float64]
    triangles: NDArray[np.int64]
    triangle_uv: NDArray[np.int64]
    triangle_materials: NDArray[np.int64]
    materials: list[str]
    libraries: list[str]


def read_statements(path: Path) -> ObjStatements:
    """Read a whole OBJ file. Raises ScanDamagedError naming the line, ScanTooLargeError."""
    gathered = _Gathered()
    for number, lines in _iter_blocks(path):
        gathered.add(lines, number)
    return gathered.finish()


def _iter_blocks(path: Path) -> Iterator[tuple[int, list[bytes]]]:
    """Yield whole lines, with the number of the first."""
    number, rest = 1, b""
    with path.open("rb") as stream:
        while data := stream.read(_BLOCK_BYTES):
            text = rest + data
            end = max(text.rfind(b"\n"), text.rfind(b"\r")) + 1
            if len(text) - end > _LONGEST_LINE:
                raise ScanDamagedError(
                    f"Line {number:,} of the OBJ file or one soon after it does not end. Export the scan again."
                )
            lines, rest = text[:end].splitlines(), text[end:]
            yield number, lines
            number += len(lines)
    if rest:
        yield number, rest.splitlines()


@dataclass
class _Gathered:
    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    texture_coordinates: list[NDArray[np.float64]] = field(default_factory=list)
    faces: list[NDArray[np.int64]] = field(default_factory=list)  # (n, 7): vertices, texture coordinates, material
    materials: dict[str, int] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)
    num_vertices: int = 0
    num_coordinates: int = 0
    num_faces: int = 0
    material: int = -1
    num_columns: int | None = None

    def add(self, lines: list[bytes], first_number: int) -> None:
        """Take lines; runs of the same kind are parsed at once."""
        start = 0
        kinds = [line[:2] for line in lines]
        while start < len(lines):
            kind, stop = kinds[start], start + 1
            while stop < len(lines) and kinds[stop] == kind:
                stop += 1
            self._add_run(kind.replace(b"\t", b" "), lines[start:stop], first_number + start)
            start = stop

    def finish(self) -> ObjStatements:
        """Return everything, with faces that are checked against what they refer to."""
        width = self.num_columns or 3
        faces = np.concatenate(self.faces) if self.faces else np.empty((0, 7), np.int64)
        _check_numbers(faces[:, :3], self.num_vertices, 0, "vertex")
        _check_numbers(faces[:, 3:6], self.num_coordinates, -1, "texture coordinate")
        return ObjStatements(
            np.concatenate(self.vertices) if self.vertices else np.empty((0, width)),
            np.concatenate(self.texture_coordinates) if self.texture_coordinates else np.empty((0, 2)),
            faces[:, :3],
            faces[:, 3:6],
            faces[:, 6],
            list(self.materials),
            self.libraries,
        )

    def _add_run(self, kind: bytes, lines: list[bytes], number: int) -> None:
        if kind == b"v ":
            self._add_vertices(lines, number)
        elif kind == b"vt":
            self.texture_coordinates.append(_numbers(lines, number, (2, 3, 1))[:, :2])
            self.num_coordinates += len(lines)
            _check_room(self.num_coordinates)
        elif kind == b"f ":
            self._add_faces(lines, number)
        elif kind in (b"us", b"mt"):
            for line in lines:
                word, _, name = line.partition(b" ")
                text = name.strip().decode("utf-8", "replace")
                if word == b"usemtl":
                    self.material = self.materials.setdefault(text, len(self.materials))
                elif word == b"mtllib":
                    self.libraries.append(text)

    def _add_vertices(self, lines: list[bytes], number: int) -> None:
        rows = _numbers(lines, number, (3, 6, 4, 7))
        if rows.shape[1] in (4, 7):  # a weight behind the position
            rows = np.delete(rows, 3, axis=1)
        if self.num_columns not in (None, rows.shape[1]):
            raise ScanDamagedError(
                f"From line {number:,} on the vertices have other columns than before. Export the scan again."
            )
        self.num_columns = rows.shape[1]
        self.vertices.append(rows)
        self.num_vertices += len(rows)
        _check_room(self.num_vertices)

    def _add_faces(self, lines: list[bytes], number: int) -> None:
        by_form: dict[tuple[int, int], list[bytes]] = {}
        for line in lines:
            words = line.split()
            by_form.setdefault((len(words) - 1, words[-1].count(b"/")), []).append(line)
        for (num_corners, num_slashes), same in by_form.items():
            if num_corners < 3:
                raise ScanDamagedError(
                    f"A face near line {number:,} has {num_corners} corners: {same[0][:60]!r}. {CUT_SHORT}"
                )
            text = b"\n".join(line[2:] for line in same).replace(b"//", b"/0/").replace(b"/", b" ")
            numbers = parse_numbers(text)
            is_whole = numbers is not None and len(numbers) == len(same) * num_corners * (num_slashes + 1)
            if numbers is None or not is_whole or not np.isfinite(numbers).all():
                raise ScanDamagedError(f"A face near line {number:,} is not understood: {same[0][:60]!r}. {CUT_SHORT}")
            corners = numbers.astype(np.int64).reshape(len(same), num_corners, num_slashes + 1)
            vertex = _from_zero(corners[:, :, 0], self.num_vertices)
            uv = np.full_like(vertex, -1) if num_slashes == 0 else _from_zero(corners[:, :, 1], self.num_coordinates)
            for last in range(2, num_corners):  # a polygon becomes a fan
                fan = [0, last - 1, last]
                material = np.full((len(same), 1), self.material)
                self.faces.append(np.concatenate([vertex[:, fan], uv[:, fan], material], axis=1))
                self.num_faces += len(same)
                _check_room(self.num_faces)


def _from_zero(numbers: NDArray[np.int64], num_before: int) -> NDArray[np.int64]:
    """Return numbers that count from 0: OBJ counts from 1, negative ones back from the last; 0 is none."""
    return np.where(numbers < 0, numbers + num_before, numbers - 1)


def _numbers(lines: list[bytes], number: int, widths: tuple[int, ...]) -> NDArray[np.float64]:
    """Parse lines of one width, the keyword left out; shorter ones are filled up with zeros to two columns."""
    values = parse_numbers(b"\n".join(line[2:] for line in lines))
    if values is not None and len(values):
        for width in widths:
            counts = {len(lines[0].split()) - 1, len(lines[-1].split()) - 1}
            if len(values) == len(lines) * width and counts == {width}:
                rows = values.reshape(len(lines), width)
                return rows if width > 1 else np.column_stack([rows, np.zeros(len(rows))])
    for place, line in enumerate(lines):
        found = parse_numbers(line[2:])
        if found is None or len(found) not in widths or len(found) != len(lines[0].split()) - 1:
            raise ScanDamagedError(
                f"Line {number + place:,} of the OBJ file is not understood: {line[:60]!r}; expected {widths[0]} numbers as in "
                f"the lines before. {CUT_SHORT}"
            )
    raise ScanDamagedError(f"The lines from {number:,} on are not understood. {CUT_SHORT}")


def _check_numbers(numbers: NDArray[np.int64], count: int, lowest: int, what: str) -> None:
    outside = (numbers < lowest) | (numbers >= count)
    if outside.any():
        raise ScanDamagedError(
            f"A face of the OBJ file refers to {what} {numbers[outside][0] + 1}, but there are {count:,}. "
            "The mesh is damaged; export it again."
        )


def _check_room(count: int) -> None:
    if count > MAX_ROWS:
        raise ScanTooLargeError(
            f"The OBJ file has more than {MAX_ROWS:,} vertices or triangles. Simplify the mesh or split it."
        )
