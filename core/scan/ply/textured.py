"""PLY meshes with textures beside them, as MeshLab and programs of photogrammetry write them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanContentError, ScanDamagedError
from core.scan.companions import companion
from core.scan.mesh.sampling import iter_surface_samples
from core.scan.mesh.surface import Paint, SurfacePart
from core.scan.mesh.texture import Texture, TextureReader
from core.scan.ply.binary_body import RowBatch
from core.scan.ply.body import PlyBody
from core.scan.ply.columns import POSITION_NAMES
from core.scan.ply.header import PlyElement, PlyHeader
from core.scan.ply.mesh import has_mesh, index_name
from core.scan.reading_context import RawChunk, ReadingContext, stack_columns

_PER_CORNER = "texcoord"
_PER_VERTEX = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_NUMBER = "texnumber"


def texture_names(header: PlyHeader) -> list[str]:
    """Return the names of the texture files that the comments of the header give."""
    pairs = (comment.partition(" ") for comment in header.comments)
    return [name.strip() for word, _, name in pairs if word.lower() == "texturefile" and name.strip()]


def has_texture(header: PlyHeader) -> bool:
    """Tell whether the faces have textures and say where each corner lies in them."""
    return bool(texture_names(header)) and has_mesh(header) and (_is_per_corner(header) or _pair(header) is not None)


def read_textured(context: ReadingContext, header: PlyHeader, body: PlyBody) -> Iterator[RawChunk]:
    """Yield points on the faces with the colours of their textures, uint8. Raises ScanDamagedError and ScanContentError."""
    reader = TextureReader()
    textures = [reader.read(companion(context, name, "texture").read_bytes(), name) for name in texture_names(header)]
    positions, coordinates, faces = np.empty((0, 3)), np.empty((0, 2)), np.empty((0, 3), np.int64)
    uv, numbers = np.empty((0, 3, 2)), np.empty(0, np.int64)
    for element in header.elements:
        if element.name == "vertex":
            positions, coordinates = _vertices(element, body, _pair(header))
        elif element.name == "face":
            faces, uv, numbers = _faces(element, body)
        else:
            body.skip(element)
    _check(faces, len(positions), "vertex")
    _check(numbers, len(textures), "texture")
    if not _is_per_corner(header):
        uv = coordinates[faces]
    uv = uv * [1.0, -1.0] + [0.0, 1.0]  # counted from the lower edge
    parts = [_part(positions, faces, uv, numbers == number, texture) for number, texture in enumerate(textures)]
    yield from iter_surface_samples([part for part in parts if len(part.triangles)], context)


def _part(
    positions: NDArray[np.float64],
    faces: NDArray[np.int64],
    uv: NDArray[np.float64],
    chosen: NDArray[np.bool_],
    texture: Texture,
) -> SurfacePart:
    return SurfacePart(positions, faces[chosen], Paint(texture, uv[chosen]))


def _vertices(
    element: PlyElement, body: PlyBody, pair: tuple[str, str] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = list(body.iter_scalar_rows(element, [*POSITION_NAMES, *(pair or ())]))
    positions = np.concatenate([stack_columns(part, POSITION_NAMES, np.float64) for part in rows])
    if pair is None:
        return positions, np.empty((0, 2))
    columns = [np.concatenate([part[name] for part in rows]).astype(np.float64) for name in pair]
    return positions, np.stack(columns, axis=1)


def _faces(element: PlyElement, body: PlyBody) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return the triangles, (T, 3), the place of each corner in the texture, (T, 3, 2), and the number of the texture, (T,)."""
    faces, uv, numbers = [np.empty((0, 3), np.int64)], [np.empty((0, 3, 2))], [np.empty(0, np.int64)]
    for batches in body.iter_list_rows(element):
        for batch in batches:
            corners, places = _corners(batch, element)
            names = batch.records.dtype.names or ()
            number = batch.records[_NUMBER].astype(np.int64) if _NUMBER in names else np.zeros(len(corners), np.int64)
            for last in range(2, corners.shape[1]):  # a polygon becomes a fan
                faces.append(corners[:, [0, last - 1, last]])
                uv.append(places[:, [0, last - 1, last]])
                numbers.append(number)
    return np.concatenate(faces), np.concatenate(uv), np.concatenate(numbers)


def _corners(batch: RowBatch, element: PlyElement) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    name = index_name(element)
    assert name is not None
    corners = np.nan_to_num(batch.records[name], nan=-1.0).clip(-1, 1 << 40).astype(np.int64)
    num_corners = corners.shape[1]
    if not any(prop.name == _PER_CORNER for prop in element.properties):
        return corners, np.zeros((len(corners), num_corners, 2))
    places = batch.records[_PER_CORNER].astype(np.float64)
    if places.shape[1] != 2 * num_corners:
        raise ScanDamagedError(
            f"A face of the PLY mesh has {num_corners} corners, but {places.shape[1]} texture coordinates; expected two per corner. "
            "Export the scan again."
        )
    return corners, places.reshape(len(corners), num_corners, 2)


def _check(numbers: NDArray[np.int64], count: int, what: str) -> None:
    outside = (numbers < 0) | (numbers >= count)
    if outside.any():
        raise ScanDamagedError(
            f"A face refers to {what} {numbers[outside][0]}, but there are {count:,}. The mesh is damaged; export it again."
        )
    if not len(numbers):
        raise ScanContentError("The PLY mesh has a texture, but no faces. Export the scan again.")


def _is_per_corner(header: PlyHeader) -> bool:
    faces = header.element("face")
    return faces is not None and any(
        prop.name == _PER_CORNER and prop.count_type is not None for prop in faces.properties
    )


def _pair(header: PlyHeader) -> tuple[str, str] | None:
    vertices = header.element("vertex")
    scalars = {prop.name for prop in vertices.properties if prop.count_type is None} if vertices is not None else set()
    return next((pair for pair in _PER_VERTEX if scalars.issuperset(pair)), None)
