"""What glTF materials paint: base colour, its texture, and the older and simpler ways to say so."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panoloc.core.scan.gltf.file import GltfFile, Json
from panoloc.core.scan.mesh.sampling import linear_to_srgb
from panoloc.core.scan.mesh.surface import Paint, Texture, TextureReader, Wrap

_WRAPS: dict[Any, Wrap] = {33071: "clamp", 33648: "mirror"}
_CUTOFF = 0.5
_UNSIGNED_BYTE = 5121


class Materials:
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
