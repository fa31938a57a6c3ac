"""The outside of a glTF file: its JSON, and the bytes of its buffers and images."""

import base64
import binascii
import json
import struct
from typing import Any
from urllib.parse import unquote

from core.errors import CUT_SHORT, ScanContentError, ScanDamagedError
from core.scan.companions import companion
from core.scan.reading_context import ReadingContext

Json = dict[str, Any]
_MAX_JSON_BYTES = 1 << 27
_MAX_BUFFER_BYTES = 1 << 31
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
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
    """The JSON of a glTF file, `document`, and its bytes. Raises ScanDamagedError and ScanContentError."""

    def __init__(self, context: ReadingContext) -> None:
        self._context = context
        with context.path.open("rb") as stream:
            is_binary = stream.read(4) == b"glTF"
        self._binary = b""
        text = self._read_glb() if is_binary else context.path.read_bytes()[: _MAX_JSON_BYTES + 1]
        self.document = _parsed(text)
        self._buffers: dict[int, bytes] = {}
        _check_extensions(self.document)

    def view(self, number: int) -> tuple[memoryview, int]:
        """Return the bytes of a buffer view, and the bytes from one element to the next, 0 where they are packed."""
        view = self.document["bufferViews"][_index(number)]
        data = self._buffer(_index(view["buffer"]))
        start, length = _count(view.get("byteOffset", 0)), _count(view["byteLength"])
        if start + length > len(data):
            raise ScanDamagedError(
                f"The glTF file places {length:,} bytes at byte {start:,} of a buffer that has {len(data):,}. {CUT_SHORT}"
            )
        return memoryview(data)[start : start + length], _count(view.get("byteStride", 0))

    def image(self, number: int) -> tuple[bytes, str]:
        """Return an image file, and what it is called."""
        image = self.document["images"][_index(number)]
        name = str(image.get("name") or image.get("uri", "")[:60] or f"number {number}")
        if "bufferView" in image:
            return bytes(self.view(image["bufferView"])[0]), name
        return self._referred(image["uri"], "texture"), name

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            buffer = self.document["buffers"][number]
            data = self._referred(buffer["uri"], "buffer") if "uri" in buffer else self._binary
            if len(data) < _count(buffer["byteLength"]):
                raise ScanDamagedError(
                    f"The glTF file announces a buffer of {buffer['byteLength']:,} bytes, but there are {len(data):,}. {CUT_SHORT}"
                )
            self._buffers[number] = data
        return self._buffers[number]

    def _referred(self, uri: str, what: str) -> bytes:
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            try:
                return base64.b64decode(text, validate=True) if head.endswith(";base64") else unquote(text).encode()
            except binascii.Error as error:
                raise ScanDamagedError(
                    f"A {what} inside the glTF file is no base64 text ({error}). {CUT_SHORT}"
                ) from error
        if "://" in uri:
            raise ScanContentError(
                f"The glTF file refers to the {what} {uri[:100]!r} by a URL; nothing is fetched. Export it as GLB."
            )
        path = companion(self._context, unquote(uri), what)
        if path.stat().st_size > _MAX_BUFFER_BYTES:
            raise ScanContentError(
                f"The {what} {uri[:100]!r} has more than {_MAX_BUFFER_BYTES:,} bytes; split the scan."
            )
        return path.read_bytes()

    def _read_glb(self) -> bytes:
        size = self._context.size_bytes
        if size > _MAX_BUFFER_BYTES:
            raise ScanContentError(
                f"The GLB file has {size:,} bytes; at most {_MAX_BUFFER_BYTES:,} are read. Split the scan."
            )
        data = self._context.path.read_bytes()
        version, announced = struct.unpack_from("<II", data, 4) if len(data) >= 12 else (2, 12)
        if version != 2:
            raise ScanContentError(
                f"The file is glTF version {version}; expected 2. Export it again with a newer program."
            )
        if announced > len(data):
            raise ScanDamagedError(
                f"The GLB header announces {announced:,} bytes, but the file has {len(data):,}. {CUT_SHORT}"
            )
        chunks: dict[int, bytes] = {}
        position = 12
        while position + 8 <= announced:
            length, kind = struct.unpack_from("<II", data, position)
            if position + 8 + length > announced:
                raise ScanDamagedError(
                    f"A chunk of the GLB file announces {length:,} bytes, more than there are. {CUT_SHORT}"
                )
            chunks.setdefault(kind, data[position + 8 : position + 8 + length])
            position += 8 + length
        if _JSON_CHUNK not in chunks:
            raise ScanDamagedError(f"The GLB file has no description (JSON chunk). {CUT_SHORT}")
        self._binary = chunks.get(_BINARY_CHUNK, b"")
        return chunks[_JSON_CHUNK]


def _parsed(text: bytes) -> Json:
    if len(text) > _MAX_JSON_BYTES:
        raise ScanContentError(f"The glTF description has more than {_MAX_JSON_BYTES:,} bytes. Export the scan as GLB.")
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise ScanDamagedError(f"The glTF description is no JSON ({str(error)[:100]}). {CUT_SHORT}") from error
    if not isinstance(document, dict) or "asset" not in document:
        raise ScanDamagedError("The file is JSON, but no glTF: it has no 'asset'. Export the scan again.")
    version = str(document["asset"].get("version"))
    if not version.startswith("2"):
        raise ScanContentError(
            f"The file is glTF version {version[:10]}; expected 2.0. Export it again with a newer program."
        )
    return document


def _check_extensions(document: Json) -> None:
    for name in document.get("extensionsRequired", []):
        if name in _COMPRESSED:
            raise ScanContentError(
                f"The glTF file uses {_COMPRESSED[name]} ({name}), which is not read. Export it without, with JPEG or PNG textures."
            )
        if not str(name).startswith(_HARMLESS):
            raise ScanContentError(
                f"The glTF file needs the extension {str(name)[:60]}, which is not known. Export it without."
            )


def _index(number: Any) -> int:
    """Return a place in a list; negative ones would count from its end."""
    if not isinstance(number, int) or isinstance(number, bool) or number < 0:
        raise ScanDamagedError(f"The glTF file refers to entry {number!r} of a list. Export the scan again.")
    return number


def _count(number: Any) -> int:
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 1 << 48:
        raise ScanDamagedError(f"The glTF file has {str(number)[:40]} where a size is expected. Export the scan again.")
    return number
