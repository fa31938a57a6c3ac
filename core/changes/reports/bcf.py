"""Changes as BCF 2.1 (buildingSMART): a topic with a viewpoint and a snapshot per object, as tools for building models open it."""

import io
import uuid
import zipfile
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
from PIL import Image

from panoloc.core.changes.reports.report import ChangeReport, kind_words, place_words, size_words

_NAMES = uuid.UUID("0d0a3a52-7a94-5d1e-9f0c-3c2d5f1f6b11")  # of topics: the same object keeps its own
_AUTHOR = "panoloc"
_FIELD_OF_VIEW = "60"


def as_bcf(report: ChangeReport) -> bytes:
    """Return the zip."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        version = Xml.Element("Version", VersionId="2.1")
        _add(version, "DetailedVersion", "2.1")
        archive.writestr("bcf.version", _bytes_of(version))
        for number, each in enumerate(report.objects, 1):
            topic, view = (str(uuid.uuid5(_NAMES, f"{part} {each['id']}")) for part in ("topic", "view"))
            picture = report.pictures.get(each["id"])
            archive.writestr(f"{topic}/markup.bcf", _markup(number, each, topic, view, picture is not None))
            archive.writestr(f"{topic}/viewpoint.bcfv", _viewpoint(each, view))
            if picture is not None:
                png = io.BytesIO()
                Image.open(io.BytesIO(picture)).save(png, "PNG")
                archive.writestr(f"{topic}/snapshot.png", png.getvalue())
    return buffer.getvalue()


def _markup(number: int, each: dict[str, Any], topic: str, view: str, has_picture: bool) -> bytes:
    root = Xml.Element("Markup")
    about = Xml.SubElement(root, "Topic", Guid=topic, TopicType="Change", TopicStatus="Open")
    _add(about, "Title", f"{number}. {kind_words(each)}, {size_words(each['size_m'])}")
    _add(about, "Index", str(number))
    _add(about, "Labels", each["kind"])
    if not each["is_sure"]:
        _add(about, "Labels", "unsure")
    _add(about, "CreationDate", each["last_seen_at"])
    _add(about, "CreationAuthor", _AUTHOR)
    seen = f"certainty {each['certainty']:.0%}, seen by {each['num_photos']} photos"
    _add(
        about,
        "Description",
        f"At {place_words(each, '; ')} (metres); {seen}. Snapshot: photo left, scan right.",
    )
    shown = Xml.SubElement(root, "Viewpoints", Guid=view)
    _add(shown, "Viewpoint", "viewpoint.bcfv")
    if has_picture:
        _add(shown, "Snapshot", "snapshot.png")
    return _bytes_of(root)


def _viewpoint(each: dict[str, Any], view: str) -> bytes:
    """Return a view of the object from where the photo that shows it best was taken."""
    center = np.array(each["center_m"])
    position = np.array(each["seen_from_m"])
    direction = (center - position) / max(float(np.linalg.norm(center - position)), 1e-6)
    left = np.cross((0.0, 0.0, 1.0), direction)
    left = np.array([0.0, 1.0, 0.0]) if np.linalg.norm(left) < 1e-6 else left / np.linalg.norm(left)
    root = Xml.Element("VisualizationInfo", Guid=view)
    camera = Xml.SubElement(root, "PerspectiveCamera")
    vectors = (
        ("CameraViewPoint", position),
        ("CameraDirection", direction),
        ("CameraUpVector", np.cross(direction, left)),
    )
    for name, vector in vectors:
        element = Xml.SubElement(camera, name)
        for axis, value in zip("XYZ", vector, strict=True):
            _add(element, axis, f"{value:.6f}")
    _add(camera, "FieldOfView", _FIELD_OF_VIEW)
    return _bytes_of(root)


def _add(parent: Xml.Element, name: str, text: str) -> None:
    Xml.SubElement(parent, name).text = text


def _bytes_of(root: Xml.Element) -> bytes:
    data: bytes = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    return data
