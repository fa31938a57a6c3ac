"""Stanford 2D-3D-S (Armeni et al., 2017): as published, or in the layout of the paper's reference implementation.

published                                             reference implementation
area_1/pano/rgb/camera_<id>_<room>_<n>_…_rgb.png      pano/area_1/camera_<id>_<room>_<n>_…_rgb.png
area_1/pano/pose/camera_<id>_<room>_<n>_…_pose.json   pose/area_1/camera_<id>_<room>_<n>_…_pose.json
Area_1/<room>_<n>/<room>_<n>.txt  (S3DIS, not aligned)  pcd/area_1/<room>_<n>.txt
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from core.geometry.pose import Pose
from core.options import IndexOptions
from core.scan.reading import read_scan
from lab.evaluation.dataset_files import chosen, images_in, pose_of, read_image, without_black_poles
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError

_IMAGE = re.compile(r"camera_[0-9a-zA-Z]+_(?P<room>[A-Za-z]+_\d+)_frame_equirectangular_domain_rgb\.png")


@dataclass(frozen=True)
class _Area:
    """Where the files of one area are."""

    name: str
    images: Path
    poses: Path
    root: Path


def stanford(root: Path, split: str | None = None) -> list[ScanCases]:
    """Return one scan per area and room; split: `area_1` to `area_6`, None for all that are there."""
    areas = [_Area(f.parent.parent.name, f, f.parent / "pose", root) for f in sorted(root.glob("area_*/pano/rgb"))]
    areas += [_Area(f.name, f, root / "pose" / f.name, root) for f in sorted(root.glob("pano/area_*"))]
    if not areas:
        raise SourceError(f"{root}: expected area_<n>/pano/rgb or pano/area_<n> (docs/evaluation.md), found neither")
    names = chosen(split, tuple(area.name for area in areas), "stanford2d3ds")
    return [scan for area in areas if area.name in names for scan in _scans_of(area)]


def _scans_of(area: _Area) -> list[ScanCases]:
    rooms: dict[str, list[str]] = {}
    for name in images_in(area.images):
        match = _IMAGE.fullmatch(name)
        if match is None:
            raise SourceError(
                f"{area.images / name}: expected camera_<id>_<room>_<n>_frame_equirectangular_domain_rgb.png"
            )
        rooms.setdefault(match["room"], []).append(name)
    return [
        ScanCases(
            name=f"stanford/{area.name}/{room}",
            group=f"stanford2d3ds {area.name}",
            query_names=tuple(names),
            load=lambda room=room: _load(area, room),  # type: ignore[misc]
            place=f"{area.name}/{room}",
        )
        for room, names in sorted(rooms.items())
    ]


def _load(area: _Area, room: str) -> LoadedScan:
    def query(name: str) -> KnownQuery:
        """Read a panorama and its pose."""
        pose = _read_pose(area.poses / name.replace("_rgb.png", "_pose.json"))
        return KnownQuery(without_black_poles(read_image(area.images / name)), (pose,), tags=(area.name,))

    return LoadedScan(read_scan(_cloud_file(area, room)), IndexOptions(), query)


def _cloud_file(area: _Area, room: str) -> Path:
    """Return the cloud in the frame of the poses; the aligned version of S3DIS is turned against it and refused."""
    root = area.root
    places = [
        root / "pcd" / area.name / f"{room}.txt",
        *(root.glob(f"{area.name.capitalize()}/{room}/{room}.txt")),
        *(root.glob(f"*/{area.name.capitalize()}/{room}/{room}.txt")),
        *(root.glob(f"{area.name}/**/{room}/{room}.txt")),
    ]
    files = [place for place in places if place.is_file()]
    kept = [file for file in files if "aligned_version" not in str(file.relative_to(root)).lower()]
    if not kept and files:
        raise SourceError(f"{files[0]}: expected the version that is not aligned, in whose frame the poses are")
    if not kept:
        raise SourceError(
            f"{places[0]}: expected the cloud of {room}, x y z red green blue by line, here or as in S3DIS"
        )
    return kept[0]


def _read_pose(path: Path) -> Pose:
    """Return map_from_camera of a pose file.

    camera_rt_matrix maps world to a camera with x right, y down, z forward. final_camera_rotation holds Euler angles about the fixed
    axes x, y, z of a camera with x right, y up, z back. Both describe the same camera, whose forward is the centre of the image.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if "camera_location" in values and "final_camera_rotation" in values:
            camera = _fixed_axes_rotation(*np.asarray(values["final_camera_rotation"], np.float64))
            right, up, back = camera.T
            return pose_of(
                np.stack((-back, -right, up), axis=1), np.asarray(values["camera_location"], np.float64), path
            )
        matrix = np.asarray(values["camera_rt_matrix"], np.float64)[:3]
        right, down, forward = matrix[:, :3]
        return pose_of(np.stack((forward, -right, -down), axis=1), -matrix[:, :3].T @ matrix[:, 3], path)
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise SourceError(
            f"{path}: expected JSON with camera_location and final_camera_rotation, or camera_rt_matrix ({error!r})"
        ) from error


def _fixed_axes_rotation(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return Rz(z) Ry(y) Rx(x), angles in radians."""
    cos, sin = np.cos((x, y, z)), np.sin((x, y, z))
    about_x = np.array([[1, 0, 0], [0, cos[0], -sin[0]], [0, sin[0], cos[0]]])
    about_y = np.array([[cos[1], 0, sin[1]], [0, 1, 0], [-sin[1], 0, cos[1]]])
    about_z = np.array([[cos[2], -sin[2], 0], [sin[2], cos[2], 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x, np.float64)
