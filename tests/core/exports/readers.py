"""Reads exports back by the formats' own definitions: by foreign readers where there are, else by formulas of the targets.

Each returns `map_from_camera` by name, with axes x forward, y left, z up.
"""

import csv
import json
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pycolmap
import pygltflib
from PIL import Image
from rosbags.typesys import Stores, get_typestore

from panoloc.core.geometry.pose import Pose
from panoloc.service.cli.transforms import read_transforms
from tests.core.exports.tours import rotation_of

Poses = dict[str, Pose]
# Columns are the axes of our camera (forward, left, up) in each other camera's.
CV = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
GL = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])


def quaternion(x: float, y: float, z: float, w: float) -> np.ndarray:
    """Return the rotation of a quaternion, by turning the axes with its sandwich product."""
    vector = np.array([x, y, z])
    turned = [axis + 2 * np.cross(vector, np.cross(vector, axis) + w * axis) for axis in np.eye(3)]
    return np.stack(turned, axis=1)


def potree(folder: Path) -> Poses:
    rows = [line.split("\t") for line in (folder / "coordinates.txt").read_text().splitlines()[1:]]
    found = {}
    for name, _, long, lat, alt, course, pitch, roll in rows:
        rotation = rotation_of(float(course), float(pitch), float(roll))
        found[name] = Pose(rotation, np.array([float(long), float(lat), float(alt)]))
    return found


def navvis(folder: Path) -> Poses:
    names = dict(line.split("; ") for line in (folder / "names.csv").read_text().splitlines()[1:])
    found = {}
    for line in (folder / "pano-poses.csv").read_text().splitlines()[1:]:
        _, file_name, _, *numbers = line.split("; ")
        x, y, z, qw, qx, qy, qz = map(float, numbers)
        found[names[file_name]] = Pose(quaternion(qx, qy, qz, qw), np.array([x, y, z]))
    return found


def colmap(folder: Path) -> Poses:
    return {
        image.name: from_colmap(image.cam_from_world()) for image in pycolmap.Reconstruction(folder).images.values()
    }


def from_colmap(cam_from_world: Any) -> Pose:
    rotation = cam_from_world.rotation.matrix()
    return Pose(rotation.T @ CV, -rotation.T @ cam_from_world.translation)


def colmap_rig(folder: Path) -> Poses:
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    fronts = [image for image in model.images.values() if image.name.startswith("front/")]
    return {
        re.sub(r"_jpg\.jpg$", ".jpg", each.name.removeprefix("front/")): from_colmap(each.cam_from_world())
        for each in fronts
    }


def opensfm(folder: Path) -> Poses:
    (reconstruction,) = json.loads((folder / "reconstruction.json").read_text())
    found = {}
    for name, shot in reconstruction["shots"].items():
        rotation = rodrigues(np.array(shot["rotation"]))
        found[name] = Pose(rotation.T @ CV, -rotation.T @ np.array(shot["translation"]))
    return found


def rodrigues(vector: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle else vector
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turned: np.ndarray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return turned


def nerfstudio(folder: Path) -> Poses:
    document = json.loads((folder / "transforms.json").read_text())
    frames, offset = document["frames"], np.array(document.get("map_offset_m", [0.0, 0, 0]))
    for frame in frames:
        (folder / frame["file_path"]).parent.mkdir(exist_ok=True)
        (folder / frame["file_path"]).write_bytes(b"\xff\xd8\xff")  # as a JPEG begins: the reader takes images alone
    found = {}
    for frame, image in zip(frames, read_transforms(folder, "ros"), strict=True):
        pose = image.camera["session_from_camera"]
        rotation = quaternion(**pose["quaternion"])
        found[frame["file_path"]] = Pose(rotation, np.array(list(pose["position_m"].values())) + offset)
    return found


def metashape(folder: Path) -> Poses:
    chunk = ElementTree.parse(folder / "cameras.xml").getroot()[0]
    for transform in (chunk.find("transform"), chunk.find("components/component/transform")):
        assert transform is not None
        assert [element.text for element in transform] == ["1 0 0 0 1 0 0 0 1", "0 0 0", "1"]
    found = {}
    for camera in chunk.iterfind("cameras/camera"):
        text = camera.findtext("transform")
        assert text is not None
        matrix = np.array([float(value) for value in text.split()]).reshape(4, 4)
        # The first axis of ours in theirs is the row that points forward.
        found[str(camera.get("label"))] = Pose(matrix[:3, :3] @ CV, matrix[:3, 3])
    return found


def arcgis(folder: Path) -> Poses:
    """`Rz(−heading) · Rx(pitch) · Rz(−roll)` turns a camera with axes right, up, backward, which looks straight down at first."""
    found = {}
    for row in csv.DictReader((folder / "oriented_imagery.csv").read_text().splitlines()):
        heading, pitch, roll = np.radians([float(row[f"Camera{name}"]) for name in ("Heading", "Pitch", "Roll")])
        rotation = about_z(-heading) @ about_x(pitch) @ about_z(-roll) @ GL
        found[row["Name"]] = Pose(rotation, np.array([float(row[axis]) for axis in "XYZ"]))
    return found


def stac(folder: Path) -> Poses:
    found = {}
    for item in json.loads((folder / "items.json").read_text())["features"]:
        world_to_camera = np.array(item["properties"]["pers:rotation_matrix"]).reshape(3, 3)
        position = np.array(item["properties"]["pers:perspective_center"])
        found[item["assets"]["image"]["href"]] = Pose(world_to_camera.T @ GL, position)
    return found


def gpano(folder: Path) -> Poses:
    found = {}
    for path in sorted(folder.rglob("*.jpg")):
        with Image.open(path) as image:
            fields = dict(re.findall(r'GPano:(\w+)="([^"]*)"', image.info["xmp"].decode()))
        angles = [float(fields[f"Pose{name}Degrees"]) for name in ("Heading", "Pitch", "Roll")]
        found[path.relative_to(folder).as_posix()] = Pose(rotation_of(*angles), np.full(3, np.nan))
    return found


def geojson(folder: Path) -> Poses:
    found = {}
    for feature in json.loads((folder / "photos.geojson").read_text())["features"]:
        angles = [feature["properties"][f"{name}_deg"] for name in ("heading", "elevation", "roll")]
        position = np.array(feature["geometry"]["coordinates"])
        found[feature["properties"]["name"]] = Pose(rotation_of(*angles), position)
    return found


def ros(folder: Path) -> Poses:
    """Make real messages of the documents, through the wire and back."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    found = {}
    for item in json.loads((folder / "poses.json").read_text()):
        header, stamped = item["message"]["header"], item["message"]["pose"]
        message = kinds["geometry_msgs/msg/PoseWithCovarianceStamped"](
            kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](**header["stamp"]), header["frame_id"]),
            kinds["geometry_msgs/msg/PoseWithCovariance"](
                kinds["geometry_msgs/msg/Pose"](
                    kinds["geometry_msgs/msg/Point"](**stamped["pose"]["position"]),
                    kinds["geometry_msgs/msg/Quaternion"](**stamped["pose"]["orientation"]),
                ),
                np.array(stamped["covariance"]),
            ),
        )
        wire = store.serialize_cdr(message, "geometry_msgs/msg/PoseWithCovarianceStamped")
        read: Any = store.deserialize_cdr(wire, "geometry_msgs/msg/PoseWithCovarianceStamped")
        pose = read.pose.pose
        at, turned = pose.position, pose.orientation
        found[item["image"]] = Pose(quaternion(turned.x, turned.y, turned.z, turned.w), np.array([at.x, at.y, at.z]))
    return found


def tum(folder: Path) -> Poses:
    names = [line.split(" ", 1)[1] for line in (folder / "names.txt").read_text().splitlines()]
    rows = np.loadtxt(folder / "poses.tum", ndmin=2)
    return {name: Pose(quaternion(*row[4:]), row[1:4]) for name, row in zip(names, rows, strict=True)}


def gltf(folder: Path) -> Poses:
    """Read nodes in single precision; turn the world back from y up to z up by 90 degrees about x, as 3D Tiles do."""
    z_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    found, read = {}, pygltflib.GLTF2().load(str(folder / "tour.gltf"))
    offset = np.array(read.scenes[0].extras.get("map_offset_m", [0.0, 0, 0]))
    for node in read.nodes:
        rotation = quaternion(*(float(np.float32(value)) for value in node.rotation))
        position = np.array(node.translation, np.float32).astype(np.float64)
        found[node.name.removeprefix("panorama:")] = Pose(z_up @ rotation @ GL, z_up @ position + offset)
    return found


def psv(folder: Path) -> Poses:
    """The viewer sets `group.rotation` of three.js to (tilt, pan, roll, 'YXZ'), in a world of x left, y up, z towards yaw 0, here north."""
    axes = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    found = {}
    for node in json.loads((folder / "tour.json").read_text())["virtualTour"]["nodes"]:
        pan, tilt, roll = (
            np.radians(float(node["sphereCorrection"][name].removesuffix("deg"))) for name in ("pan", "tilt", "roll")
        )
        group = about_y(pan) @ about_x(tilt) @ about_z(roll)
        rotation = about_z(np.pi / 2) @ axes.T @ group @ axes
        found[node["data"]["name"]] = Pose(rotation, np.array(node["data"]["positionM"]))
    return found


def pannellum(folder: Path) -> Poses:
    found = {}
    for name, scene in json.loads((folder / "pannellum.json").read_text())["scenes"].items():
        north, pitch, roll = (scene[field] for field in ("northOffset", "horizonPitch", "horizonRoll"))
        rotation = rotation_of(north, 0, roll) @ rotation_of(90, pitch, 0)
        found[name] = Pose(rotation, np.full(3, np.nan))
    return found


def e57_document(path: Path) -> ElementTree.Element:
    """Return the XML of an E57 file by ASTM E2807 alone, without libE57, which writes it: pages of 1024 bytes end in a checksum of four."""
    data = path.read_bytes()
    physical, length, page = struct.unpack_from("<QQQ", data, 24)
    logical = b"".join(data[begin : begin + page - 4] for begin in range(0, len(data), page))
    begin = physical - physical // page * 4
    return ElementTree.fromstring(logical[begin : begin + length])


def e57(folder: Path) -> Poses:
    found = {}
    for image in e57_document(folder / "tour.e57").iterfind("{*}images2D/{*}vectorChild"):
        w, x, y, z = (float(image.findtext(f"{{*}}pose/{{*}}rotation/{{*}}{name}") or 0) for name in "wxyz")
        position = [float(image.findtext(f"{{*}}pose/{{*}}translation/{{*}}{name}") or 0) for name in "xyz"]
        found[str(image.findtext("{*}name"))] = Pose(quaternion(x, y, z, w), np.array(position))
    return found


def about_x(angle: float) -> np.ndarray:
    return np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])


def about_y(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


def about_z(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def walk(folder: Path) -> Poses:
    data = json.loads((folder / "walk" / "data.js").read_text().removeprefix("window.panolocWalk = ").rstrip(";\n"))
    origin = np.array(data["origin"])
    return {
        each["name"]: Pose(np.array(each["rotation"]), np.array(each["position"]) + origin) for each in data["photos"]
    }


READERS: dict[str, Callable[[Path], Poses]] = {
    "tour": walk,
    "potree": potree,
    "navvis": navvis,
    "colmap": colmap,
    "colmap-rig": colmap_rig,
    "opensfm": opensfm,
    "nerfstudio": nerfstudio,
    "metashape": metashape,
    "arcgis": arcgis,
    "stac": stac,
    "e57": e57,
    "gpano": gpano,
    "ros": ros,
    "tum": tum,
    "gltf": gltf,
    "psv": psv,
    "pannellum": pannellum,
    "geojson": geojson,
}
