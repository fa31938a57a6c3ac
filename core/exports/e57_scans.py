"""Copy the scans of an E57 file into another: poses, points and all fields, integers up to 2⁵³, chunk by chunk."""

from pathlib import Path
from typing import Any

import numpy as np

_CHUNK_ROWS = 500_000


def copy_scans(target: Any, source: Path) -> None:
    """Add the scans of an E57 file to an open `pye57.E57`. Blobs are left out, and so are its images."""
    from pye57 import libe57

    opened = libe57.ImageFile(str(source), "r")
    try:
        _copy_extensions(opened, target.image_file)
        root = opened.root()
        scans = root["data3D"] if root.isDefined("data3D") else ()
        for number in range(len(scans)):
            _copy_scan(libe57, opened, scans[number], target)
    finally:
        opened.close()


def _copy_extensions(source: Any, target: Any) -> None:
    """Make fields such as `nor:normalX` known."""
    known = {target.extensionsPrefix(number) for number in range(target.extensionsCount())}
    for number in range(source.extensionsCount()):
        prefix = source.extensionsPrefix(number)
        if prefix not in known:
            target.extensionsAdd(prefix, source.extensionsUri(number))


def _copy_scan(libe57: Any, source: Any, scan: Any, target: Any) -> None:
    copied = libe57.StructureNode(target.image_file)
    for number in range(scan.childCount()):
        child = scan[number]
        if child.elementName() != "points":
            _set(libe57, copied, child, target.image_file)
    points = scan["points"]
    prototype = libe57.StructureNode(points.prototype())
    fields = [prototype[number] for number in range(prototype.childCount())]
    copied_prototype = libe57.StructureNode(target.image_file)
    for field in fields:
        _set(libe57, copied_prototype, field, target.image_file)
    codecs = libe57.VectorNode(target.image_file, True)
    copied_points = libe57.CompressedVectorNode(target.image_file, copied_prototype, codecs)
    copied.set("points", copied_points)
    target.data3d.append(copied)
    _copy_rows(libe57, source, target.image_file, points, copied_points, fields)


def _copy_rows(libe57: Any, source: Any, target: Any, points: Any, copied_points: Any, fields: list[Any]) -> None:
    rows = max(1, min(_CHUNK_ROWS, points.childCount()))
    # As doubles, of which each field gets back its own kind; columns of 64-bit integers are misread by pye57 0.4.
    columns = {field.elementName(): np.zeros(rows) for field in fields}

    def buffers_of(file: Any) -> Any:
        """Return the columns as buffers that a file reads into, or writes from."""
        buffers = libe57.VectorSourceDestBuffer()
        for name, column in columns.items():
            buffers.append(libe57.SourceDestBuffer(file, name, column, rows, True, True))
        return buffers

    reader, writer = points.reader(buffers_of(source)), copied_points.writer(buffers_of(target))
    try:
        while num_read := reader.read():
            writer.write(num_read)
    finally:
        writer.close()
        reader.close()


def _set(libe57: Any, parent: Any, child: Any, file: Any) -> None:
    copied = _copy(libe57, child, file)
    if copied is not None:
        parent.set(child.elementName(), copied)


def _copy(libe57: Any, node: Any, file: Any) -> Any:
    """Return a node for another file, None for a blob or a table of its own."""
    if isinstance(node, libe57.StructureNode):
        structure = libe57.StructureNode(file)
        for number in range(node.childCount()):
            _set(libe57, structure, node[number], file)
        return structure
    if isinstance(node, libe57.VectorNode):
        vector = libe57.VectorNode(file, True)
        for number in range(node.childCount()):
            copied = _copy(libe57, node[number], file)
            if copied is not None:
                vector.append(copied)
        return vector
    if isinstance(node, libe57.StringNode):
        return libe57.StringNode(file, node.value())
    if isinstance(node, libe57.IntegerNode):
        return libe57.IntegerNode(file, node.value(), node.minimum(), node.maximum())
    if isinstance(node, libe57.FloatNode):
        return libe57.FloatNode(file, node.value(), node.precision(), node.minimum(), node.maximum())
    if isinstance(node, libe57.ScaledIntegerNode):
        limits = int(node.rawValue()), int(node.minimum()), int(node.maximum())
        return libe57.ScaledIntegerNode(file, *limits, node.scale(), node.offset())
    return None
