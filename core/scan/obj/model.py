"""The lines of an OBJ file: vertices and faces become arrays, the rest stays text."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanDamagedError, ScanTooLargeError
from panoloc.core.scan.mesh import check_vertex_numbers
from panoloc.core.scan.reading_context import CHUNK_ROWS
from panoloc.core.scan.text.table import TextLines, parse_numbers

MAX_ROWS = 50_000_000
"""Of vertices, texture coordinates or faces."""


@dataclass(frozen=True)
class ObjModel:
    """vertices: (V, 3 or 6), colours behind the position. texture_coordinates: (U, 2).

    triangles, triangle_uv: (T, 3) numbers of both, −1 where a corner has no texture coordinate. materials: names in the
    order of their first use. triangle_materials: (T,) numbers of those, −1: none. libraries: names of material files.
    """

    vertices: NDArray[np.float64]
    texture_coordinates: NDArray[np.float64]
    triangles: NDArray[np.int64]
    triangle_uv: NDArray[np.int64]
    triangle_materials: NDArray[np.int64]
    materials: list[str]
    libraries: list[str]


def read_model(path: Path) -> ObjModel:
    """Read a whole OBJ file. Raises ScanDamagedError naming the line, ScanTooLargeError."""
    gathered = _Gathered()
    with path.open("rb") as stream:
        text = TextLines(stream)
        while (block := text.take(CHUNK_ROWS)) is not None:
            lines = [block.line(row) for row in range(len(block))]
            keywords = [line.split(maxsplit=1)[0] for line in lines]
            for keyword, run in groupby(
                range(len(lines)), keywords.__getitem__
            ):  # lines of one kind are parsed together
                rows = list(run)
                handle = _HANDLERS.get(keyword)
                if handle is not None:
                    handle(gathered, [lines[row][len(keyword) :] for row in rows], int(block.numbers[rows[0]]))
    return gathered.finish()


@dataclass
class _Gathered:
    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    texture_coordinates: list[NDArray[np.float64]] = field(default_factory=lambda: [np.empty((0, 2))])
    faces: list[NDArray[np.int64]] = field(default_factory=list)  # (n, 7): vertices, texture coordinates, material
    materials: dict[str, int] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)
    num_vertices: int = 0
    num_coordinates: int = 0
    num_faces: int = 0
    material: int = -1

    def add_vertices(self, lines: list[bytes], number: int) -> None:
        """Take `v x y z [weight] [red green blue]`."""
        rows = _table(lines, number, (3, 6, 4, 7))
        if rows.shape[1] in (4, 7):
            rows = np.delete(rows, 3, axis=1)
        if self.vertices and rows.shape[1] != self.vertices[0].shape[1]:
            raise ScanDamagedError(
                f"From line {number:,} on, the vertices have different columns than before. Export the scan again."
            )
        self.vertices.append(rows)
        self.num_vertices = _counted(self.num_vertices + len(rows))

    def add_coordinates(self, lines: list[bytes], number: int) -> None:
        """Take `vt u [v] [w]`."""
        rows = _table(lines, number, (2, 3, 1))
        self.texture_coordinates.append(np.pad(rows, ((0, 0), (0, 1)))[:, :2])
        self.num_coordinates = _counted(self.num_coordinates + len(rows))

    def add_faces(self, lines: list[bytes], number: int) -> None:
        """Take `f`, its corners as vertex, vertex/coordinate, vertex//normal or vertex/coordinate/normal."""
        by_form: dict[tuple[int, int], list[bytes]] = {}
        for line in lines:
            words = line.split()
            by_form.setdefault((len(words), words[-1].count(b"/") if words else 0), []).append(line)
        for (num_corners, num_slashes), same in by_form.items():
            text = b" ".join(same).replace(b"//", b"/0/").replace(b"/", b" ")
            numbers = parse_numbers(text)
            num_expected = len(same) * num_corners * (num_slashes + 1)
            is_whole = numbers is not None and len(numbers) == num_expected and np.isfinite(numbers).all()
            if numbers is None or not is_whole or num_corners < 3:
                raise ScanDamagedError(
                    f"A face near line {number:,} is not understood: {same[0][:60]!r}; expected three corners or more. {CUT_SHORT}"
                )
            corners = numbers.astype(np.int64).reshape(len(same), num_corners, num_slashes + 1)
            vertex = _from_zero(corners[:, :, 0], self.num_vertices)
            uv = np.full_like(vertex, -1) if num_slashes == 0 else _from_zero(corners[:, :, 1], self.num_coordinates)
            for last in range(2, num_corners):  # a polygon becomes a fan
                fan = [0, last - 1, last]
                material = np.full((len(same), 1), self.material)
                self.faces.append(np.concatenate([vertex[:, fan], uv[:, fan], material], axis=1))
                self.num_faces = _counted(self.num_faces + len(same))

    def add_material(self, lines: list[bytes], number: int) -> None:
        """Take `usemtl`, of which the last counts."""
        self.material = self.materials.setdefault(_text(lines[-1]), len(self.materials))

    def add_library(self, lines: list[bytes], number: int) -> None:
        """Take `mtllib`."""
        self.libraries += [_text(line) for line in lines]

    def finish(self) -> ObjModel:
        """Return everything, with faces that are checked against what they refer to."""
        faces = np.concatenate(self.faces) if self.faces else np.empty((0, 7), np.int64)
        check_vertex_numbers(faces[:, :3], self.num_vertices, "vertex")
        check_vertex_numbers(faces[:, 3:6][faces[:, 3:6] != -1], self.num_coordinates, "texture coordinate")
        return ObjModel(
            np.concatenate(self.vertices) if self.vertices else np.empty((0, 3)),
            np.concatenate(self.texture_coordinates),
            faces[:, :3],
            faces[:, 3:6],
            faces[:, 6],
            list(self.materials),
            self.libraries,
        )


_HANDLERS: dict[bytes, Callable[[_Gathered, list[bytes], int], None]] = {
    b"v": _Gathered.add_vertices,
    b"vt": _Gathered.add_coordinates,
    b"f": _Gathered.add_faces,
    b"usemtl": _Gathered.add_material,
    b"mtllib": _Gathered.add_library,
}


def _text(line: bytes) -> str:
    return line.strip().decode("utf-8", "replace")


def _from_zero(numbers: NDArray[np.int64], num_before: int) -> NDArray[np.int64]:
    """Return numbers that count from 0: OBJ counts from 1, negative ones back from the last; 0 is none."""
    return np.where(numbers < 0, numbers + num_before, numbers - 1)


def _table(lines: list[bytes], number: int, widths: tuple[int, ...]) -> NDArray[np.float64]:
    """Parse lines of one of these widths, all the same; number: of the first line."""
    width = len(lines[0].split())
    values = parse_numbers(b" ".join(lines))
    if width in widths and values is not None and len(values) == len(lines) * width:
        return values.reshape(len(lines), width)
    parsed = [parse_numbers(line) for line in lines]
    wrong = (row for row, found in enumerate(parsed) if found is None or len(found) != width or width not in widths)
    place = next(wrong, 0)
    raise ScanDamagedError(
        f"Line {number + place:,} of the OBJ file is not understood: {lines[place][:60]!r}; expected {widths[0]} numbers, or as many "
        f"as in the lines before. {CUT_SHORT}"
    )


def _counted(count: int) -> int:
    if count > MAX_ROWS:
        raise ScanTooLargeError(
            f"The OBJ file has more than {MAX_ROWS:,} vertices or triangles. Simplify the mesh or split it."
        )
    return count
