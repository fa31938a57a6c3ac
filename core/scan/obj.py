"""Read OBJ models: their surfaces are sampled evenly with their textures' or vertices' colours."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanContentError, ScanDamagedError, ScanTooLargeError
from panoloc.core.scan.mesh import (
    Paint,
    SurfacePart,
    Texture,
    TextureReader,
    Wrap,
    check_vertex_numbers,
    fan_of,
    in_fans,
    iter_surface_samples,
)
from panoloc.core.scan.reading_context import CHUNK_ROWS, RawChunk, ReadingContext, no_color_error
from panoloc.core.scan.text.table import TextLines, is_number, parse_numbers

# Options of map_Kd that take more than one value: how many at most.
_NUM_VALUES = {"-mm": 2, "-o": 3, "-s": 3, "-t": 3}
MAX_ROWS = 50_000_000
"""Of vertices, texture coordinates or faces."""


@dataclass(frozen=True)
class ObjMaterial:
    """diffuse: (3,), sRGB 0..1. texture: name of its file, or None. scale, offset: (2,), of texture coordinates."""

    diffuse: NDArray[np.float64]
    texture: str | None = None
    scale: tuple[float, ...] = (1.0, 1.0)
    offset: tuple[float, ...] = (0.0, 0.0)
    clamped: bool = False


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


def read_obj(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield points on the surface; colours are uint8.

    Raises ScanDamagedError for lines that it does not understand, ScanContentError without colour or without a file.
    """
    model = ObjModel(context.path)
    if not len(model.vertices):
        raise ScanContentError("The OBJ file holds no vertices. Export the scan again.")
    colors = model.vertices[:, 3:6] if model.vertices.shape[1] == 6 else None
    if colors is not None and np.nanmax(colors) > 1.01:
        colors = colors / 255.0
    if len(model.triangles):
        yield from iter_surface_samples(_parts(context, model, colors), context)
        return
    if colors is None:
        raise no_color_error("no faces, and no colours after the positions of its vertices")
    points = SurfacePart(model.vertices[:, :3], np.empty((0, 3), np.int64), Paint(vertex_colors=colors))
    yield from iter_surface_samples([points], context)


def _parts(context: ReadingContext, model: ObjModel, colors: NDArray[np.float64] | None) -> list[SurfacePart]:
    """Return one part per material. A lone file with colours of its own needs no materials."""
    materials: dict[str, ObjMaterial] = {}
    if colors is None or context.folder is not None:
        for name in dict.fromkeys(model.libraries):
            materials.update(read_materials(context.companion(name, "material file")))
    reader = TextureReader()
    textures: dict[str, Texture] = {}
    parts = []
    for number in np.unique(model.triangle_materials).tolist():
        name = model.materials[number] if number >= 0 else ""
        material = materials.get(name, ObjMaterial(np.ones(3)))
        chosen = model.triangle_materials == number
        paint = Paint(vertex_colors=colors, factor=material.diffuse)
        if material.texture is not None:
            if material.texture not in textures:
                path = context.companion(material.texture, "texture")
                textures[material.texture] = reader.read(path.read_bytes(), material.texture)
            numbers = model.triangle_uv[chosen]
            num_without = int((numbers < 0).any(axis=1).sum())
            if num_without:
                context.note(
                    "texture_unused",
                    f"The material {name[:80]!r} has the texture {material.texture[:80]!r}, but {num_without:,} of its "
                    f"{len(numbers):,} triangles have no texture coordinates: no triangle shows the texture. "
                    "Export the model with texture coordinates.",
                    "warning",
                )
            else:
                placed = model.texture_coordinates[numbers] * material.scale + material.offset
                uv = placed * [1.0, -1.0] + [0.0, 1.0]  # OBJ counts v from the lower edge
                wrap: Wrap = "clamp" if material.clamped else "repeat"
                texture = replace(textures[material.texture], wrap=(wrap, wrap))
                paint = Paint(texture, uv, factor=material.diffuse)
        parts.append(SurfacePart(model.vertices[:, :3], model.triangles[chosen], paint))
    return parts


def read_materials(path: Path) -> dict[str, ObjMaterial]:
    """Return the materials of an MTL file by name. Raises ScanDamagedError."""
    found: dict[str, ObjMaterial] = {}
    name = ""
    for number, line in enumerate(path.read_text("utf-8-sig", "replace").splitlines(), start=1):
        word, _, rest = line.strip().partition(" ")
        material = found.get(name, ObjMaterial(np.ones(3)))
        try:
            if word.lower() == "newmtl":
                name = rest.strip()
                found[name] = ObjMaterial(np.ones(3))
            elif word.lower() == "kd" and material.texture is None:
                found[name] = replace(material, diffuse=np.array(rest.split()[:3], np.float64).reshape(3))
            elif word.lower() == "map_kd":
                # Many programs write black beside a texture; the texture is what they show.
                found[name] = _mapped(rest)
        except ValueError as error:
            raise ScanDamagedError(
                f"Line {number} of the material file {path.name} is not understood: {line[:80]!r}. Export the scan again."
            ) from error
    return found


def _mapped(text: str) -> ObjMaterial:
    """Parse `[-option value …] file name`; the name may hold spaces."""
    options: dict[str, list[str]] = {}
    words = text.split()
    while words and words[0].startswith("-"):
        option = words.pop(0).lower()
        values = options[option] = words[:1]
        del words[:1]
        while words and len(values) < _NUM_VALUES.get(option, 1) and is_number(words[0]):
            values.append(words.pop(0))
    scale = (*map(float, options.get("-s", ())), 1.0, 1.0)[:2]
    offset = (*map(float, options.get("-o", ())), 0.0, 0.0)[:2]
    name = text[text.index(words[0]) :].strip() if words else None
    return ObjMaterial(np.ones(3), name, scale, offset, options.get("-clamp") == ["on"])


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
