"""E57 (ASTM E2807): the points of the map and the photos, with their poses, in one file."""

import math
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.frames import quaternion_wxyz
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour, why_not_as_named
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_points_of_map

_BLOBS = {".jpg": "jpegImage", ".jpeg": "jpegImage", ".png": "pngImage"}
_AXES = ("cartesianX", "cartesianY", "cartesianZ")
_CHUNK_ROWS = 500_000


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can."""
    if photo.image is None:
        return "E57 holds the photo itself, which no longer exists"
    if PurePosixPath(photo.name).suffix.lower() not in _BLOBS:
        return "E57 holds only JPEG and PNG images"
    return why_not_as_named(photo)


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.e57`: the scans of the survey, else one of the map's points, and `images2D` with spherical images.

    Poses are camera to file, which is the map's own frame; body axes x forward, y left, z up. No image names a scan as
    its own, because the scanner did not take it. Raises ExportRefusedError where the package pye57 is missing.
    """
    try:
        import pye57  # noqa: F401
    except ImportError as error:
        raise ExportRefusedError(
            "e57: expected the package pye57, but the service runs without it; choose another format"
        ) from error
    with tempfile.TemporaryDirectory(prefix="panoloc-e57-") as folder:
        path = Path(folder) / "tour.e57"
        file = _new_file(path, _coordinate_metadata(tour))
        try:
            if tour.survey is not None:
                _copy_scans(file, tour.survey)
            elif tour.scan is not None:
                _add_points(file, tour.scan)
            images = file.root["images2D"]
            for photo in tour.photos:
                _add_image(file.image_file, images, photo)
        finally:
            file.close()
        yield ExportedFile("tour.e57", path)


def _coordinate_metadata(tour: Tour) -> str:
    """Return the coordinate system of the file's positions, which are in metres, as WKT; empty where it is not known."""
    if tour.coordinate_system is not None and tour.georeference is None:
        return coordinate_system(tour.coordinate_system).wkt_in_metres
    if tour.survey is None:
        return ""
    from pye57 import libe57

    opened = libe57.ImageFile(str(tour.survey), "r")
    try:
        root = opened.root()
        return str(root["coordinateMetadata"].value()) if root.isDefined("coordinateMetadata") else ""
    finally:
        opened.close()


def _new_file(path: Path, coordinate_metadata: str) -> Any:
    """Return an open `pye57.E57`, which itself writes no coordinate system."""
    from pye57 import E57, libe57

    class File(E57):  # type: ignore[misc]
        def write_default_header(self) -> None:
            """Write what `pye57` writes there, and the coordinate system."""
            file = self.image_file
            file.extensionsAdd("", libe57.E57_V1_0_URI)
            texts = {"formatName": "ASTM E57 3D Imaging Data File", "guid": f"{{{uuid.uuid4()}}}"}
            texts |= {"e57LibraryVersion": libe57.E57_LIBRARY_ID, "coordinateMetadata": coordinate_metadata}
            for name, text in texts.items():
                self.root.set(name, libe57.StringNode(file, text))
            for name, number in (("versionMajor", libe57.E57_FORMAT_MAJOR), ("versionMinor", libe57.E57_FORMAT_MINOR)):
                self.root.set(name, libe57.IntegerNode(file, number))
            for name in ("data3D", "images2D"):
                self.root.set(name, libe57.VectorNode(file, True))

    return File(str(path), mode="w")


def _add_points(file: Any, scan: Path) -> None:
    cloud = read_points_of_map(scan, ScanOptions.max_points)
    positions = cloud.positions.astype(np.float64) + cloud.origin_offset
    # The scan's own pose takes the large coordinates, because points are written in single precision.
    shift = np.floor(positions.min(axis=0))
    columns: dict[str, Any] = dict(zip(_AXES, (positions - shift).T, strict=True))
    columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T, strict=True))
    file.write_scan_raw(columns, name="map", rotation=np.array([1.0, 0, 0, 0]), translation=shift)


def _add_image(image_file: Any, images: Any, photo: PlacedPhoto) -> None:
    from pye57 import libe57

    def structure(**children: Any) -> Any:
        """Return a node of the file with named children; numbers are written in double precision."""
        node = libe57.StructureNode(image_file)
        for name, child in children.items():
            node.set(name, libe57.FloatNode(image_file, child) if isinstance(child, float) else child)
        return node

    assert photo.image is not None
    pose, data = photo.map_from_camera, np.frombuffer(photo.image.read_bytes(), np.uint8).copy()
    blob = _BLOBS[PurePosixPath(photo.name).suffix.lower()]
    sphere = structure(
        **{blob: libe57.BlobNode(image_file, len(data))},
        imageWidth=libe57.IntegerNode(image_file, photo.width),
        imageHeight=libe57.IntegerNode(image_file, photo.height),
        pixelWidth=2 * math.pi / photo.width,
        pixelHeight=math.pi / photo.height,
    )
    rotation = structure(**dict(zip("wxyz", quaternion_wxyz(pose.rotation), strict=True)))
    translation = structure(**dict(zip("xyz", pose.position.tolist(), strict=True)))
    images.append(
        structure(
            guid=libe57.StringNode(image_file, f"{{{uuid.uuid4()}}}"),
            name=libe57.StringNode(image_file, photo.name),
            pose=structure(rotation=rotation, translation=translation),
            sphericalRepresentation=sphere,
        )
    )
    # A blob can be filled when its node is part of the file.
    images[len(images) - 1]["sphericalRepresentation"][blob].write(data, 0, len(data))


def _copy_scans(target: Any, source: Path) -> None:
    """Add the scans of an E57 file to an open `pye57.E57`: poses, points and all fields, integers up to 2⁵³, in chunks.

    Blobs are left out, and so are its images.
    """
    from pye57 import libe57

    opened = libe57.ImageFile(str(source), "r")
    try:
        _copy_extensions(opened, target.image_file)
        root = opened.root()
        for scan in _children(root["data3D"]) if root.isDefined("data3D") else ():
            _copy_scan(libe57, opened, scan, target)
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
    file, points = target.image_file, scan["points"]
    copied = _copy(libe57, scan, file)  # without its points, which are a table
    prototype = libe57.StructureNode(points.prototype())
    codecs = libe57.VectorNode(file, True)
    copied_points = libe57.CompressedVectorNode(file, _copy(libe57, prototype, file), codecs)
    copied.set("points", copied_points)
    target.data3d.append(copied)
    rows = max(1, min(_CHUNK_ROWS, points.childCount()))
    # As doubles, of which each field gets back its own kind; columns of 64-bit integers are misread by pye57 0.4.
    columns = {field.elementName(): np.zeros(rows) for field in _children(prototype)}

    def buffers_of(image_file: Any) -> Any:
        """Return the columns as buffers that a file reads into, or writes from."""
        buffers = libe57.VectorSourceDestBuffer()
        for name, column in columns.items():
            buffers.append(libe57.SourceDestBuffer(image_file, name, column, rows, True, True))
        return buffers

    reader, writer = points.reader(buffers_of(source)), copied_points.writer(buffers_of(file))
    try:
        while num_read := reader.read():
            writer.write(num_read)
    finally:
        writer.close()
        reader.close()


def _children(node: Any) -> Iterator[Any]:
    return (node[number] for number in range(node.childCount()))


def _copy(libe57: Any, node: Any, file: Any) -> Any:
    """Return a node for another file, None for a blob or a table of its own."""
    if isinstance(node, libe57.StructureNode):
        structure = libe57.StructureNode(file)
        for child in _children(node):
            if (copied := _copy(libe57, child, file)) is not None:
                structure.set(child.elementName(), copied)
        return structure
    if isinstance(node, libe57.VectorNode):
        vector = libe57.VectorNode(file, True)
        for child in _children(node):
            if (copied := _copy(libe57, child, file)) is not None:
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
