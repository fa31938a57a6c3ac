"""A glTF 2.0 file: its JSON, and the numbers and images that the JSON refers to."""

import base64
import json
import struct
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from panoloc.core.errors import CUT_SHORT, ScanContentError, ScanDamagedError
from panoloc.core.scan.reading_context import ReadingContext

Json = dict[str, Any]
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
# Extensions that change nothing of where surfaces are and what is painted on them, or that are understood.
_HARMLESS = (
    "KHR_materials_",
    "KHR_lights_",
    "KHR_texture_transform",
    "KHR_mesh_quantization",
    "EXT_texture_webp",
    "KHR_xmp",
)
_COMPRESSED = {
    "KHR_draco_mesh_compression": "Draco compression",
    "EXT_meshopt_compression": "meshopt compression",
    "KHR_texture_basisu": "KTX2 textures",
}


class GltfFile:
    """The JSON of a glTF file, `document`, and its bytes.

    Raises ScanDamagedError and ScanContentError. JSON that contradicts itself also raises KeyError, TypeError, ValueError
    and their like.
    """

    def __init__(self, context: ReadingContext) -> None:
        self._context = context
        data = context.path.read_bytes()
        chunks = _chunks(data) if data[:4] == b"glTF" else {_JSON_CHUNK: data}
        self._buffers: dict[int, bytes] = {}
        self._binary = chunks.get(_BINARY_CHUNK, b"")
        try:
            self.document: Json = json.loads(chunks[_JSON_CHUNK].decode("utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise ScanDamagedError(f"The glTF description is not JSON ({str(error)[:100]}). {CUT_SHORT}") from error
        _check_version(self.document["asset"]["version"])
        _check_extensions(self.document)

    def entry(self, kind: str, number: Any) -> Json:
        """Return an entry of one of the lists of the JSON, such as "nodes"."""
        if not isinstance(number, int) or number < 0:  # negative ones would count from the end
            raise ScanDamagedError(
                f"The glTF file refers to entry {str(number)[:40]} of its {kind}, which does not exist. Export the "
                "scan again."
            )
        found: Json = self.document[kind][number]
        return found

    def array(self, number: Any) -> NDArray[Any]:
        """Return an accessor as (n, width) in its stored type; normalized integers as float64."""
        accessor = self.entry("accessors", number)
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ScanContentError(
                "The glTF file uses sparse accessors, which are not supported. Export the scan as plain GLB."
            )
        dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        stride = self.entry("bufferViews", accessor["bufferView"]).get("byteStride") or width * dtype.itemsize
        data, offset = self._view(accessor["bufferView"]), accessor.get("byteOffset", 0)
        values: NDArray[Any] = np.ndarray((accessor["count"], width), dtype, data, offset, (stride, dtype.itemsize))
        if accessor.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / float(np.iinfo(dtype).max), -1.0)
        return values

    def image(self, number: Any) -> tuple[bytes, str]:
        """Return an image file, and what it is called."""
        image = self.entry("images", number)
        name = str(image.get("name") or image.get("uri", "")[:60] or f"number {number}")
        data = self._view(image["bufferView"]) if "bufferView" in image else self._referred(image["uri"], "texture")
        return bytes(data), name

    def _view(self, number: Any) -> memoryview:
        view = self.entry("bufferViews", number)
        number, start, length = view["buffer"], view.get("byteOffset", 0), view["byteLength"]
        buffer = self.entry("buffers", number)
        if number not in self._buffers:
            self._buffers[number] = self._referred(buffer["uri"], "buffer") if "uri" in buffer else self._binary
        data = self._buffers[number]
        if not 0 <= start <= start + length <= len(data):
            raise ScanDamagedError(
                f"The glTF file places {length:,} bytes at byte {start:,} of a buffer that has {len(data):,}. {CUT_SHORT}"
            )
        return memoryview(data)[start : start + length]

    def _referred(self, uri: str, what: str) -> bytes:
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            return base64.b64decode(text, validate=True) if head.endswith(";base64") else unquote(text).encode()
        if "://" in uri:
            raise ScanContentError(
                f"The glTF file refers to the {what} {uri[:100]!r} by a URL, and readers fetch nothing. Export it as "
                "GLB."
            )
        return self._context.companion(unquote(uri), what).read_bytes()


def _chunks(data: bytes) -> dict[int, bytes]:
    """Return the chunks of a GLB file by their kind."""
    version, announced = struct.unpack_from("<II", data.ljust(12, b"\0"), 4)
    chunks: dict[int, bytes] = {}
    position = 12
    while position + 8 <= min(announced, len(data)):
        length, kind = struct.unpack_from("<II", data, position)
        chunks.setdefault(kind, data[position + 8 : position + 8 + length])
        position += 8 + length
    if max(announced, position) > len(data) or (version == 2 and _JSON_CHUNK not in chunks):
        raise ScanDamagedError(
            f"The GLB file announces {max(announced, position):,} bytes with a JSON chunk, but has {len(data):,}. {CUT_SHORT}"
        )
    _check_version(version)
    return chunks


def _check_version(version: Any) -> None:
    if not str(version).startswith("2"):
        raise ScanContentError(
            f"The file is glTF version {str(version)[:10]}; expected 2.0. Export it again with a newer program."
        )


def _check_extensions(document: Json) -> None:
    for name in document.get("extensionsRequired", []):
        if name in _COMPRESSED:
            raise ScanContentError(
                f"The glTF file uses {_COMPRESSED[name]} ({name}), which is not supported. Export it without this "
                "compression, with JPEG or PNG textures."
            )
        if not str(name).startswith(_HARMLESS):
            raise ScanContentError(
                f"The glTF file needs the extension {str(name)[:60]}, which is not supported. Export it without this "
                "extension."
            )
