"""E57 files by libE57: nodes, poses and scans."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
RED_GREEN_BLUE = ("colorRed", "colorGreen", "colorBlue")


def structure(image_file: Any, **children: Any) -> Any:
    """Return a node with named children: nodes, or numbers and texts that become some."""
    from pye57 import libe57

    kinds = {float: libe57.FloatNode, int: libe57.IntegerNode, str: libe57.StringNode}
    node = libe57.StructureNode(image_file)
    for name, child in children.items():
        node.set(name, kinds[type(child)](image_file, child) if type(child) in kinds else child)
    return node


def pose_node(image_file: Any, rotation_wxyz: Sequence[float], translation: Sequence[float]) -> Any:
    """Return the pose of a scan or an image."""
    rotation = structure(image_file, **dict(zip("wxyz", map(float, rotation_wxyz), strict=True)))
    position = structure(image_file, **dict(zip("xyz", map(float, translation), strict=True)))
    return structure(image_file, rotation=rotation, translation=position)


def buffers_of(image_file: Any, columns: Mapping[str, NDArray[np.float64]]) -> Any:
    """Return columns as buffers that a file reads into, or writes from."""
    from pye57 import libe57

    buffers = libe57.VectorSourceDestBuffer()
    for name, column in columns.items():
        buffers.append(libe57.SourceDestBuffer(image_file, name, column, len(column), True, True))
    return buffers


def add_scan(file: Any, columns: Mapping[str, NDArray[Any]], kinds: Mapping[str, Any], **children: Any) -> None:
    """Append a scan to an open `pye57.E57`. kinds: nodes of fields that are no doubles. children: of the scan."""
    from pye57 import libe57

    image_file = file.image_file
    doubles = {name: libe57.FloatNode(image_file, 0.0, libe57.E57_DOUBLE) for name in columns}
    prototype = structure(image_file, **{**doubles, **kinds})
    scan = structure(image_file, **children)
    points = libe57.CompressedVectorNode(image_file, prototype, libe57.VectorNode(image_file, True))
    scan.set("points", points)
    file.data3d.append(scan)
    kept = {name: np.ascontiguousarray(column, np.float64) for name, column in columns.items()}
    writer = points.writer(buffers_of(image_file, kept))
    writer.write(len(next(iter(kept.values()))))
    writer.close()
