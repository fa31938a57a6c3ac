"""Read OBJ models: their surfaces are sampled evenly with their textures' or vertices' colours."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanContentError
from panoloc.core.scan.companions import companion
from panoloc.core.scan.mesh.sampling import iter_surface_samples
from panoloc.core.scan.mesh.surface import Paint, SurfacePart, Texture, TextureReader, Wrap
from panoloc.core.scan.obj.materials import ObjMaterial, read_materials
from panoloc.core.scan.obj.model import ObjModel, read_model
from panoloc.core.scan.reading_context import RawChunk, ReadingContext, no_color_error


def read_obj(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield points on the surface; colours are uint8.

    Raises ScanDamagedError for lines that it does not understand, ScanContentError without colour or without a file.
    """
    model = read_model(context.path)
    if not len(model.vertices):
        raise ScanContentError("The OBJ file holds no vertices. Export the scan again.")
    colors = _vertex_colors(model)
    if len(model.triangles):
        yield from iter_surface_samples(_parts(context, model, colors), context)
        return
    if colors is None:
        raise no_color_error("no faces, and no colours after the positions of its vertices")
    points = SurfacePart(model.vertices[:, :3], np.empty((0, 3), np.int64), Paint(vertex_colors=colors))
    yield from iter_surface_samples([points], context)


def _vertex_colors(model: ObjModel) -> NDArray[np.float64] | None:
    if model.vertices.shape[1] < 6:
        return None
    colors = model.vertices[:, 3:6]
    return colors / 255.0 if np.nanmax(colors) > 1.01 else colors


def _parts(context: ReadingContext, model: ObjModel, colors: NDArray[np.float64] | None) -> list[SurfacePart]:
    """Return one part per material. A lone file with colours of its own needs no materials."""
    materials: dict[str, ObjMaterial] = {}
    if colors is None or context.folder is not None:
        for name in dict.fromkeys(model.libraries):
            materials.update(read_materials(companion(context, name, "material file")))
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
                path = companion(context, material.texture, "texture")
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
                paint = _textured(material, textures[material.texture], model.texture_coordinates[numbers])
        parts.append(SurfacePart(model.vertices[:, :3], model.triangles[chosen], paint))
    return parts


def _textured(material: ObjMaterial, texture: Texture, uv: NDArray[np.float64]) -> Paint:
    placed = (uv * material.scale + material.offset) * [1.0, -1.0] + [0.0, 1.0]  # OBJ counts v from the lower edge
    wrap: Wrap = "clamp" if material.clamped else "repeat"
    return Paint(Texture(texture.pixels, (wrap, wrap)), placed, factor=material.diffuse)
