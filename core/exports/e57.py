"""E57 (ASTM E2807): the points of the map and the photos, with their poses, in one file."""

import math
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports.axes import quaternion_wxyz
from panoloc.core.exports.e57_scans import copy_scans
from panoloc.core.exports.image_kind import why_not_as_named
from panoloc.core.exports.tour import ExportedFile, PlacedPhoto, Tour
from panoloc.core.options import ScanOptions
from panoloc.core.scan.reading import read_scan

_BLOBS = {".jpg": "jpegImage", ".jpeg": "jpegImage", ".png": "pngImage"}


def why_not(photo: PlacedPhoto) -> str | None:
    """Return why a photo cannot be written, None when it can."""
    if photo.image is None:
        return "E57 holds the photo itself, which no longer exists"
    if PurePosixPath(photo.name).suffix.lower() not in _BLOBS:
        return "E57 holds only JPEG and PNG images"
    return why_not_as_named(photo.name, photo.image)


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `tour.e57`: the scans of the survey, else one of the map's points, and `images2D` with spherical images.

    Poses are camera to file, which is the map's own frame; body axes x forward, y left, z up. No image names a scan as its
    own, because the scanner did not take it. Raises ExportRefusedError where the package pye57 is missing.
    """
    try:
        from pye57 import E57
    except ImportError as error:
        raise ExportRefusedError(
            "e57: expected the package pye57, but the service runs without it; choose another format"
        ) from error
    with tempfile.TemporaryDirectory(prefix="panoloc-e57-") as folder:
        path = Path(folder) / "tour.e57"
        file = E57(str(path), mode="w")
        try:
            if tour.survey is not None:
                copy_scans(file, tour.survey)
            elif tour.scan is not None:
                _add_points(file, tour.scan)
            images = file.root["images2D"]
            for photo in tour.photos:
                images.append(_image(file.image_file, photo))
                _fill_blob(images[len(images) - 1], photo)
        finally:
            file.close()
        yield ExportedFile("tour.e57", path)


def _add_points(file: Any, scan: Path) -> None:
    cloud = read_scan(scan, ScanOptions(max_points_used=ScanOptions.max_points))
    positions = cloud.positions.astype(np.float64) + cloud.origin_offset
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), positions.T, strict=True))
    columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T, strict=True))
    # The scan's own pose takes the large coordinates, because points are written in single precision.
    shift = np.floor(positions.min(axis=0))
    for name, offset in zip(("cartesianX", "cartesianY", "cartesianZ"), shift, strict=True):
        columns[name] = columns[name] - offset
    file.write_scan_raw(columns, name="map", rotation=np.array([1.0, 0, 0, 0]), translation=shift)


def _image(image_file: Any, photo: PlacedPhoto) -> Any:
    from pye57 import libe57

    def structure(**children: Any) -> Any:
        """Return a node of the file with named children."""
        node = libe57.StructureNode(image_file)
        for name, child in children.items():
            node.set(name, child)
        return node

    def number(value: float) -> Any:
        """Return a number in double precision as a node of the file."""
        return libe57.FloatNode(image_file, float(value))

    assert photo.image is not None
    pose = photo.map_from_camera
    rotation = structure(
        **{name: number(value) for name, value in zip("wxyz", quaternion_wxyz(pose.rotation), strict=True)}
    )
    position = structure(**{name: number(value) for name, value in zip("xyz", pose.position, strict=True)})
    blob = _BLOBS[PurePosixPath(photo.name).suffix.lower()]
    sphere = structure(
        **{blob: libe57.BlobNode(image_file, photo.image.stat().st_size)},
        imageWidth=libe57.IntegerNode(image_file, photo.width),
        imageHeight=libe57.IntegerNode(image_file, photo.height),
        pixelWidth=number(2 * math.pi / photo.width),
        pixelHeight=number(math.pi / photo.height),
    )
    return structure(
        guid=libe57.StringNode(image_file, f"{{{uuid.uuid4()}}}"),
        name=libe57.StringNode(image_file, photo.name),
        pose=structure(rotation=rotation, translation=position),
        sphericalRepresentation=sphere,
    )


def _fill_blob(node: Any, photo: PlacedPhoto) -> None:
    assert photo.image is not None
    data = np.frombuffer(photo.image.read_bytes(), np.uint8).copy()
    blob = node["sphericalRepresentation"][_BLOBS[PurePosixPath(photo.name).suffix.lower()]]
    blob.write(data, 0, len(data))
