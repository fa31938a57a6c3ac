"""Read OBJ models: their surfaces are sampled evenly with their textures' or vertices' colours."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError, ScanDamagedError
from panoloc.core.scan.mesh import Paint, SurfacePart, Texture, TextureReader, Wrap, iter_surface_samples
from panoloc.core.scan.obj.model import ObjModel
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, no_color_error
from panoloc.core.scan.text.table import is_number

# Options of map_Kd that take more than one value: how many at most.
_NUM_VALUES = {"-mm": 2, "-o": 3, "-s": 3, "-t": 3}


@dataclass(frozen=True)
class ObjMaterial:
    """diffuse: (3,), sRGB 0..1. texture: name of its file, or None. scale, offset: (2,), of texture coordinates."""

    diffuse: NDArray[np.float64]
    texture: str | None = None
    scale: tuple[float, ...] = (1.0, 1.0)
    offset: tuple[float, ...] = (0.0, 0.0)
    clamped: bool = False


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
