"""Read glTF models: their surfaces are sampled evenly with the colours that are painted on them."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanDamagedError, ScanTooLargeError
from core.scan.gltf.accessors import file_index, read_accessor
from core.scan.gltf.container import GltfFile, Json
from core.scan.gltf.materials import Materials
from core.scan.gltf.nodes import iter_meshes
from core.scan.mesh.sampling import iter_surface_samples
from core.scan.mesh.surface import SurfacePart
from core.scan.reading_context import RawChunk, ReadingContext

MAX_TRIANGLES = 20_000_000
_POINTS, _TRIANGLES, _STRIP, _FAN = 0, 4, 5, 6


def read_gltf(context: ReadingContext) -> Iterator[RawChunk]:
    """Yield points on the surfaces of the scene; colours are uint8. y is up in every glTF file, so that z is in what is yielded.

    Raises ScanDamagedError for a file that contradicts itself, ScanContentError for one that has no colour or is compressed.
    """
    try:
        parts = _parts(GltfFile(context))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        reason = f"{type(error).__name__}: {str(error)[:80]}"
        raise ScanDamagedError(f"The glTF description contradicts itself ({reason}). Export the scan again.") from error
    if context.options.up_axis == "z":
        context.note(
            "axes_converted", "The scan is y-up, as every glTF file; (x, y, z) became (x, −z, y), so that z is up."
        )
    for chunk in iter_surface_samples(parts, context):
        # Whoever says that y is up has it turned together with every other format.
        turned = chunk.positions[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
        yield chunk if context.options.up_axis == "y" else replace(chunk, positions=turned)


def _parts(file: GltfFile) -> list[SurfacePart]:
    materials = Materials(file)
    parts = []
    num_triangles = 0
    for number, matrix in iter_meshes(file.document):
        for primitive in file.document["meshes"][number]["primitives"]:
            part = _part(file, materials, primitive, matrix)
            if part is None:
                continue
            num_triangles += max(len(part.triangles), len(part.positions) // 3)
            if num_triangles > MAX_TRIANGLES:
                raise ScanTooLargeError(
                    f"The glTF scene has more than {MAX_TRIANGLES:,} triangles, instances included. Simplify the mesh or split it."
                )
            parts.append(part)
    return parts


def _part(file: GltfFile, materials: Materials, primitive: Json, matrix: NDArray[np.float64]) -> SurfacePart | None:
    mode = primitive.get("mode", _TRIANGLES)
    if mode not in (_POINTS, _TRIANGLES, _STRIP, _FAN):
        return None  # lines
    positions = read_accessor(file, primitive["attributes"]["POSITION"], "vertices").astype(np.float64)
    if "indices" in primitive:
        corners = read_accessor(file, file_index(primitive["indices"]), "triangle corners")[:, 0].astype(np.int64)
    else:
        corners = np.arange(len(positions))
    if len(corners) and corners.max() >= len(positions):
        raise ScanDamagedError(
            f"A triangle of the glTF file refers to vertex {corners.max()}, but there are {len(positions):,} vertices. "
            "The mesh is damaged; export it again."
        )
    triangles = _triangles(corners, mode)
    placed = positions[:, :3] @ matrix[:3, :3].T + matrix[:3, 3]
    return SurfacePart(placed, triangles, materials.paint(primitive, triangles))


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _POINTS:
        return np.empty((0, 3), np.int64)
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    first = corners[:-2] if mode == _STRIP else np.broadcast_to(corners[:1], (max(len(corners) - 2, 0),))
    return np.stack([first, corners[1:-1], corners[2:]], axis=1)
