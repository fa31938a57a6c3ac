"""Read OBJ models: their surfaces are sampled evenly with their textures' or vertices' colours."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanContentError
from core.scan.companions import companion
from core.scan.mesh.sampling import iter_surface_samples
from core.scan.mesh.surface import Paint, SurfacePart
from core.scan.mesh.texture import Texture, TextureReader
from core.scan.obj.materials import ObjMaterial, read_materials
from core.scan.obj.statements import ObjStatements, read_statements
from core.scan.reading_context import RawChunk, ReadingContext, no_color_error


def read_obj(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield points on the surface; colours are uint8.

    Raises ScanDamagedError for lines that are not understood, ScanContentError without colour or where a file is missing.
    """
    statements = read_statements(context.path)
    if not len(statements.vertices):
        raise ScanContentError("The OBJ file holds no vertices. Export the scan again.")
    vertex_colors = _vertex_colors(statements)
    materials = _materials(context, statements) if vertex_colors is None or context.folder is not None else {}
    parts = _parts(context, statements, materials, vertex_colors)
    if not parts:
        if vertex_colors is None:
            raise no_color_error("no faces, and no colours behind the positions of its vertices")
        parts = [
            SurfacePart(statements.vertices[:, :3], np.empty((0, 3), np.int64), Paint(vertex_colors=vertex_colors))
        ]
    yield from iter_surface_samples(parts, context)


def _vertex_colors(statements: ObjStatements) -> NDArray[np.float64] | None:
    if statements.vertices.shape[1] < 6:
        return None
    colors = statements.vertices[:, 3:6]
    return colors / 255.0 if np.nanmax(colors) > 1.01 else colors


def _materials(context: ReadingContext, statements: ObjStatements) -> dict[str, ObjMaterial]:
    found: dict[str, ObjMaterial] = {}
    for name in dict.fromkeys(statements.libraries):
        found.update(read_materials(companion(context, name, "material file")))
    return found


def _parts(
    context: ReadingContext,
    statements: ObjStatements,
    materials: dict[str, ObjMaterial],
    vertex_colors: NDArray[np.float64] | None,
) -> list[SurfacePart]:
    reader = TextureReader()
    textures: dict[str, Texture] = {}
    parts = []
    for number in np.unique(statements.triangle_materials).tolist():
        name = statements.materials[number] if number >= 0 else ""
        material = materials.get(name, ObjMaterial(np.ones(3)))
        if material.texture is not None and material.texture not in textures:
            path = companion(context, material.texture, "texture")
            textures[material.texture] = reader.read(path.read_bytes(), material.texture)
        chosen = statements.triangle_materials == number
        texture = None if material.texture is None else textures[material.texture]
        part = _part(statements, chosen, material, texture, vertex_colors)
        if texture is not None and part.paint.texture is None:
            num_without = int((statements.triangle_uv[chosen] < 0).any(axis=1).sum())
            context.note(
                "texture_unused",
                f"The material {name[:80]!r} has the texture {str(material.texture)[:80]!r}, but {num_without:,} of its "
                f"{len(part.triangles):,} triangles have no texture coordinates: it is shown on none of them. Export the model with them.",
                "warning",
            )
        parts.append(part)
    return parts


def _part(
    statements: ObjStatements,
    chosen: NDArray[np.bool_],
    material: ObjMaterial,
    texture: Texture | None,
    vertex_colors: NDArray[np.float64] | None,
) -> SurfacePart:
    uv = None
    numbers = statements.triangle_uv[chosen]
    if texture is not None and len(statements.texture_coordinates) and (numbers >= 0).all():
        uv = statements.texture_coordinates[numbers] * material.scale + material.offset
        uv = uv * [1.0, -1.0] + [0.0, 1.0]  # OBJ counts v from the lower edge
        texture = Texture(texture.pixels, ("clamp", "clamp") if material.clamped else texture.wrap)
    is_textured = uv is not None
    paint = Paint(texture if is_textured else None, uv, None if is_textured else vertex_colors, material.diffuse)
    return SurfacePart(statements.vertices[:, :3], statements.triangles[chosen], paint)
