"""The lines of an OBJ file: vertices and faces become arrays, the rest stays text."""

from collections.abc import Callable
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanDamagedError, ScanTooLargeError
from panoloc.core.scan.mesh import check_vertex_numbers, fan_of, in_fans
from panoloc.core.scan.reading_context import CHUNK_ROWS
from panoloc.core.scan.text.table import TextLines, parse_numbers

MAX_ROWS = 50_000_000
"""Of vertices, texture coordinates or faces."""


class ObjModel:
    """A whole OBJ file.

    vertices: (V, 3 or 6), colours behind the position. texture_coordinates: (U, 2).
    triangles, triangle_uv: (T, 3) numbers of both, −1 where a corner has no texture coordinate. materials: names in the
    order of their first use. triangle_materials: (T,) numbers of those, −1: none. libraries: names of material files.
    """

    def __init__(self, path: Path) -> None:
        """Read a file. Raises ScanDamagedError naming the line, ScanTooLargeError."""
        self.libraries: list[str] = []
        self._materials: dict[str, int] = {}
        self._material = -1
        self._vertices: list[NDArray[np.float64]] = []
        self._coordinates: list[NDArray[np.float64]] = [np.empty((0, 2))]
        self._faces = [np.empty((0, 7), np.int64)]  # vertices, texture coordinates, material
        self._num_vertices = self._num_coordinates = self._num_faces = 0
        with path.open("rb") as stream:
            self._read(TextLines(stream))
        faces = np.concatenate(self._faces)
        self.triangles, self.triangle_uv, self.triangle_materials = faces[:, :3], faces[:, 3:6], faces[:, 6]
        check_vertex_numbers(self.triangles, self._num_vertices, "vertex")
        check_vertex_numbers(self.triangle_uv[self.triangle_uv != -1], self._num_coordinates, "texture coordinate")
        self.vertices = np.concatenate(self._vertices) if self._vertices else np.empty((0, 3))
        self.texture_coordinates = np.concatenate(self._coordinates)
        self.materials = list(self._materials)

    def _read(self, text: TextLines) -> None:
        handlers: dict[bytes, Callable[[list[bytes], int], None]] = {
            b"v": self._add_vertices,
            b"vt": self._add_coordinates,
            b"f": self._add_faces,
        }
        while (block := text.take(CHUNK_ROWS)) is not None:
            lines = [block.line(row) for row in range(len(block))]
            keywords = [line.split(maxsplit=1)[0] for line in lines]
            for keyword, run in groupby(range(len(lines)), keywords.__getitem__):  # one kind is parsed together
                rows = list(run)
                same = [lines[row][len(keyword) :] for row in rows]
                if keyword in handlers:
                    handlers[keyword](same, int(block.numbers[rows[0]]))
                elif keyword == b"mtllib":
                    self.libraries += [_name(line) for line in same]
                elif keyword == b"usemtl":  # the last one counts
                    self._material = self._materials.setdefault(_name(same[-1]), len(self._materials))

    def _add_vertices(self, lines: list[bytes], number: int) -> None:
        """Take `v x y z [weight] [red green blue]`."""
        rows = _table(lines, number, (3, 6, 4, 7))
        if rows.shape[1] in (4, 7):
            rows = np.delete(rows, 3, axis=1)
        if self._vertices and rows.shape[1] != self._vertices[0].shape[1]:
            raise ScanDamagedError(
                f"From line {number:,} on, the vertices have different columns than before. Export the scan again."
            )
        self._vertices.append(rows)
        self._num_vertices = _counted(self._num_vertices + len(rows))

    def _add_coordinates(self, lines: list[bytes], number: int) -> None:
        """Take `vt u [v] [w]`."""
        rows = _table(lines, number, (2, 3, 1))
        self._coordinates.append(np.pad(rows, ((0, 0), (0, 1)))[:, :2])
        self._num_coordinates = _counted(self._num_coordinates + len(rows))

    def _add_faces(self, lines: list[bytes], number: int) -> None:
        """Take `f`, its corners as vertex, vertex/coordinate, vertex//normal or vertex/coordinate/normal."""
        by_form: dict[tuple[int, int], list[bytes]] = {}
        for line in lines:
            words = line.split()
            by_form.setdefault((len(words), words[-1].count(b"/") if words else 0), []).append(line)
        for (num_corners, num_slashes), same in by_form.items():
            numbers = parse_numbers(b" ".join(same).replace(b"//", b"/0/").replace(b"/", b" "))
            num_expected = len(same) * num_corners * (num_slashes + 1)
            if num_corners < 3 or numbers is None or len(numbers) != num_expected or not np.isfinite(numbers).all():
                raise ScanDamagedError(
                    f"A face near line {number:,} is not understood: {same[0][:60]!r}; expected three corners or more. "
                    f"{CUT_SHORT}"
                )
            corners = numbers.astype(np.int64).reshape(len(same), num_corners, num_slashes + 1)
            vertex, uv = _from_zero(corners[:, :, 0], self._num_vertices), np.full(corners.shape[:2], -1)
            if num_slashes:
                uv = _from_zero(corners[:, :, 1], self._num_coordinates)
            fan = fan_of(num_corners)
            triangles = [in_fans(vertex, fan), in_fans(uv, fan), np.full((len(fan) * len(same), 1), self._material)]
            self._faces.append(np.concatenate(triangles, axis=1))
            self._num_faces = _counted(self._num_faces + len(fan) * len(same))


def _name(line: bytes) -> str:
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
        f"Line {number + place:,} of the OBJ file is not understood: {lines[place][:60]!r}; expected {widths[0]} "
        f"numbers, or as many as in the lines before. {CUT_SHORT}"
    )


def _counted(count: int) -> int:
    if count > MAX_ROWS:
        raise ScanTooLargeError(
            f"The OBJ file has more than {MAX_ROWS:,} vertices or triangles. Simplify the mesh or split it."
        )
    return count
