"""Where the meshes of a glTF scene stand."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.errors import ScanDamagedError
from core.scan.gltf.accessors import file_index
from core.scan.gltf.container import Json

_MAX_NODES = 1_000_000


def iter_meshes(document: Json) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield the meshes that the scene shows, each with its matrix, (4, 4). Raises ScanDamagedError for cycles."""
    nodes: list[Json] = document.get("nodes", [])
    waiting = [(number, np.eye(4)) for number in reversed(_roots(document, nodes))]
    seen: set[int] = set()
    while waiting:
        number, parent = waiting.pop()
        if file_index(number) in seen or len(seen) > _MAX_NODES:
            raise ScanDamagedError(
                f"Node {number} of the glTF file stands in two places, or below itself; expected a tree. Export the scan again."
            )
        seen.add(number)
        node = nodes[number]
        matrix = parent @ _matrix(node)
        if "mesh" in node:
            yield file_index(node["mesh"]), matrix
        waiting.extend((child, matrix) for child in reversed(node.get("children", [])))


def _roots(document: Json, nodes: list[Json]) -> list[Any]:
    scenes = document.get("scenes", [])
    if scenes:
        return list(scenes[file_index(document.get("scene", 0))].get("nodes", []))
    children = {child for node in nodes for child in node.get("children", [])}
    return [number for number in range(len(nodes)) if number not in children]


def _matrix(node: Json) -> NDArray[np.float64]:
    """Return parent_from_node, (4, 4); glTF stores matrices column by column and quaternions as x, y, z, w."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], np.float64).reshape(4, 4).T
    else:
        x, y, z, w = (float(value) for value in node.get("rotation", (0, 0, 0, 1)))
        turned = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        matrix = np.eye(4)
        matrix[:3, :3] = turned * np.array(node.get("scale", (1, 1, 1)), np.float64).reshape(3)
        matrix[:3, 3] = np.array(node.get("translation", (0, 0, 0)), np.float64).reshape(3)
    if not np.isfinite(matrix).all():
        raise ScanDamagedError("A node of the glTF file has a pose that is not finite. Export the scan again.")
    return matrix
