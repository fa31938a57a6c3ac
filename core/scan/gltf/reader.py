"""Read glTF models: their surfaces are sampled evenly with the colours that are painted on them."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import ScanDamagedError, ScanTooLargeError
from panoloc.core.geometry.pose import Pose
from panoloc.core.scan.gltf.file import GltfFile, Json
from panoloc.core.scan.mesh import (
    Paint,
    SurfacePart,
    Texture,
    TextureReader,
    Wrap,
    check_vertex_numbers,
    iter_surface_samples,
    linear_to_srgb,
)
from panoloc.core.scan.reading_context import RawChunk, ReadingContext

MAX_TRIANGLES = 20_000_000
_POINTS, _TRIANGLES, _STRIP, _FAN = 0, 4, 5, 6
_WRAPS: dict[Any, Wrap] = {33071: "clamp", 33648: "mirror"}
_CUTOFF = 0.5
_UNSIGNED_BYTE = 5121


class _Materials:
    """Reads the materials of a file, each image once."""

    def __init__(self, file: GltfFile) -> None:
        self._file = file
        self._reader = TextureReader()
        self._images: dict[int, Texture] = {}

    def paint(self, primitive: Json, triangles: NDArray[np.int64]) -> Paint:
        """Return what is painted on a primitive. triangles: (T, 3) numbers of its vertices."""
        material = self._file.entry("materials", primitive["material"]) if "material" in primitive else {}
        factor, texture_info = _base_color(material)
        attributes = primitive["attributes"]
        texture, uv = None, None
        if texture_info is not None:
            transform = texture_info.get("extensions", {}).get("KHR_texture_transform", {})
            name = f"TEXCOORD_{transform.get('texCoord', texture_info.get('texCoord', 0))}"
            if name in attributes:
                texture = self._texture(texture_info["index"])
                uv = _transformed(self._file.array(attributes[name])[:, :2].astype(np.float64), transform)[triangles]
        mode = material.get("alphaMode", "OPAQUE")
        cutoff = float(material.get("alphaCutoff", _CUTOFF)) if mode == "MASK" else _CUTOFF
        return Paint(texture, uv, self._vertex_colors(attributes), factor, 0.0 if mode == "OPAQUE" else cutoff)

    def _vertex_colors(self, attributes: Json) -> NDArray[np.float64] | None:
        if "COLOR_0" not in attributes:
            return None
        colors = self._file.array(attributes["COLOR_0"])[:, :3]
        if colors.dtype.kind == "u":  # whole numbers whose `normalized` is missing
            colors = colors / np.iinfo(colors.dtype).max
        # Deviation: the format calls all of them linear, but whatever writes bytes writes those of its scan or picture.
        is_bytes = self._file.entry("accessors", attributes["COLOR_0"])["componentType"] == _UNSIGNED_BYTE
        return colors if is_bytes else linear_to_srgb(colors.astype(np.float64))

    def _texture(self, number: Any) -> Texture:
        texture = self._file.entry("textures", number)
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        if source not in self._images:
            self._images[source] = self._reader.read(*self._file.image(source))
        sampler = self._file.entry("samplers", texture["sampler"]) if "sampler" in texture else {}
        wrap = (_WRAPS.get(sampler.get("wrapS"), "repeat"), _WRAPS.get(sampler.get("wrapT"), "repeat"))
        return Texture(self._images[source].pixels, wrap)


def read_gltf(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield points on the surfaces of the scene; colours are uint8. Every glTF file is y-up; what is yielded is z-up.

    Raises ScanDamagedError for a file that contradicts itself, ScanContentError for one without colour or compressed.
    """
    try:
        parts = _parts(GltfFile(context))
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise ScanDamagedError(f"The glTF description contradicts itself ({reason}). Export the scan again.") from error
    context.unit, context.up_axis, context.turned_from = "m", "z", "y"
    context.note(
        "axes_converted", "The scan is y-up, as every glTF file; (x, y, z) became (x, −z, y), so that z is up."
    )
    for chunk in iter_surface_samples(parts, context):
        yield replace(chunk, positions=chunk.positions[:, [0, 2, 1]] * [1.0, -1.0, 1.0])


def _parts(file: GltfFile) -> list[SurfacePart]:
    materials = _Materials(file)
    parts = []
    num_triangles = 0
    for mesh, matrix in _placed_meshes(file):
        for primitive in mesh["primitives"]:
            if primitive.get("mode", _TRIANGLES) not in (_POINTS, _TRIANGLES, _STRIP, _FAN):
                continue  # lines
            part = _part(file, materials, primitive, matrix)
            num_triangles += max(len(part.triangles), len(part.positions) // 3)
            if num_triangles > MAX_TRIANGLES:
                raise ScanTooLargeError(
                    f"The glTF scene has more than {MAX_TRIANGLES:,} triangles, instances included. Simplify the mesh or split it."
                )
            parts.append(part)
    return parts


def _placed_meshes(file: GltfFile) -> Iterator[tuple[Json, NDArray[np.float64]]]:
    """Yield the meshes that the scene shows, each with its matrix, (4, 4)."""
    nodes: list[Json] = file.document.get("nodes", [])
    if "scenes" in file.document:
        roots = file.entry("scenes", file.document.get("scene", 0)).get("nodes", [])
    else:
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [number for number in range(len(nodes)) if number not in children]
    waiting = [(number, np.eye(4)) for number in reversed(roots)]
    seen: set[int] = set()
    while waiting:
        number, parent = waiting.pop()
        node = file.entry("nodes", number)
        if number in seen:
            raise ScanDamagedError(
                f"Node {number} of the glTF file has two parents, or is its own descendant; expected a tree. Export "
                "the scan again."
            )
        seen.add(number)
        matrix = parent @ _matrix(node)
        if "mesh" in node:
            yield file.entry("meshes", node["mesh"]), matrix
        waiting.extend((child, matrix) for child in reversed(node.get("children", [])))


def _matrix(node: Json) -> NDArray[np.float64]:
    """Return parent_from_node, (4, 4); glTF stores matrices column by column and quaternions as x, y, z, w."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
    else:
        translation, rotation = node.get("translation", (0, 0, 0)), node.get("rotation", (0, 0, 0, 1))
        matrix = Pose.from_frame(translation, rotation, "ros").matrix
        matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64).reshape(3)
    if not np.isfinite(matrix).all():
        raise ScanDamagedError("A node of the glTF file has a pose that is not finite. Export the scan again.")
    return matrix


def _part(file: GltfFile, materials: _Materials, primitive: Json, matrix: NDArray[np.float64]) -> SurfacePart:
    positions = file.array(primitive["attributes"]["POSITION"]).astype(np.float64)
    corners = np.arange(len(positions))
    if "indices" in primitive:
        corners = file.array(primitive["indices"])[:, 0].astype(np.int64)
    triangles = _triangles(corners, primitive.get("mode", _TRIANGLES))
    check_vertex_numbers(triangles, len(positions), "vertex")
    placed = positions[:, :3] @ matrix[:3, :3].T + matrix[:3, 3]
    return SurfacePart(placed, triangles, materials.paint(primitive, triangles))


def _triangles(corners: NDArray[np.int64], mode: Any) -> NDArray[np.int64]:
    if mode == _POINTS:
        return np.empty((0, 3), np.int64)
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    first = corners[:-2] if mode == _STRIP else np.broadcast_to(corners[:1], (max(len(corners) - 2, 0),))
    return np.stack([first, corners[1:-1], corners[2:]], axis=1)


def _base_color(material: Json) -> tuple[NDArray[np.float64], Json | None]:
    """Return the factor, (3,), sRGB, and where the texture is."""
    plain = material.get("pbrMetallicRoughness", {})
    older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
    texture = plain.get("baseColorTexture") or older.get("diffuseTexture")
    factor = plain.get("baseColorFactor") or older.get("diffuseFactor") or (1, 1, 1)
    if texture is None and "emissiveTexture" in material:
        # Some programs of photogrammetry let their surfaces shine, so that no lamp is needed to see them.
        texture, factor = material["emissiveTexture"], (1, 1, 1)
    return linear_to_srgb(np.array(factor[:3], np.float64).reshape(3)), texture


def _transformed(uv: NDArray[np.float64], transform: Json) -> NDArray[np.float64]:
    """Apply KHR_texture_transform: offset · rotation · scale, counter-clockwise in the picture, whose v points down.

    So do Khronos' own viewer and three.js; the shader on the extension's page turns the other way.
    """
    angle = float(transform.get("rotation", 0.0))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    scale = np.array(transform.get("scale", (1, 1)), np.float64).reshape(2)
    offset = np.array(transform.get("offset", (0, 0)), np.float64).reshape(2)
    return np.asarray((uv * scale) @ turn.T + offset)
