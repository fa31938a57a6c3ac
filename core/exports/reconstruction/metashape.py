"""Agisoft Metashape: `cameras.xml` for File > Import > Cameras."""

from collections import Counter
from collections.abc import Iterator
from pathlib import PurePosixPath
from xml.etree import ElementTree

from panoloc.core.distinct_names import distinct_names
from panoloc.core.exports.axes import CV_FROM_FLU
from panoloc.core.exports.number_text import plain
from panoloc.core.exports.tour import ExportedFile, Tour
from panoloc.core.geometry.pose import Pose


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield spherical sensors, one per size, and poses from camera (right, down, forward) to the chunk, which is the map.

    Cameras are labelled by file names without suffix, as Metashape labels photos; with it where two would be one.
    """
    document = ElementTree.Element("document", version="2.0.0")
    chunk = ElementTree.SubElement(document, "chunk", label=tour.name, enabled="true")
    sizes = sorted({(photo.width, photo.height) for photo in tour.photos})
    sensors = ElementTree.SubElement(chunk, "sensors", next_id=str(len(sizes)))
    for number, (width, height) in enumerate(sizes):
        sensor = ElementTree.SubElement(
            sensors, "sensor", id=str(number), label=f"spherical {width} x {height}", type="spherical"
        )
        ElementTree.SubElement(sensor, "resolution", width=str(width), height=str(height))
    _add_identity(chunk)
    labels = _labels([photo.name for photo in tour.photos])
    cameras = ElementTree.SubElement(chunk, "cameras", next_id=str(len(labels)), next_group_id="0")
    for number, (photo, label) in enumerate(zip(tour.photos, labels, strict=True)):
        sensor_id = str(sizes.index((photo.width, photo.height)))
        camera = ElementTree.SubElement(
            cameras, "camera", id=str(number), sensor_id=sensor_id, component_id="0", label=label, enabled="true"
        )
        pose = photo.map_from_camera
        matrix = Pose(pose.rotation @ CV_FROM_FLU.T, pose.position).matrix
        ElementTree.SubElement(camera, "transform").text = " ".join(plain(value, 15) for value in matrix.ravel())
    ElementTree.indent(document, " ")
    yield ExportedFile("cameras.xml", ElementTree.tostring(document, "utf-8", xml_declaration=True) + b"\n")


def _add_identity(chunk: ElementTree.Element) -> None:
    """Say that the chunk is the map: readers apply the transforms of component and chunk on top of those of cameras."""
    components = ElementTree.SubElement(chunk, "components", next_id="1", active_id="0")
    component = ElementTree.SubElement(components, "component", id="0", label="Component 1")
    for parent in (component, chunk):
        transform = ElementTree.SubElement(parent, "transform")
        ElementTree.SubElement(transform, "rotation").text = "1 0 0 0 1 0 0 0 1"
        ElementTree.SubElement(transform, "translation").text = "0 0 0"
        ElementTree.SubElement(transform, "scale").text = "1"


def _labels(names: list[str]) -> list[str]:
    stems = [PurePosixPath(name).stem for name in names]
    once = {stem for stem, count in Counter(stems).items() if count == 1}
    return distinct_names(stem if stem in once else name for stem, name in zip(stems, names, strict=True))
