"""The paper's real data sets in the layouts that they are published in; docs/evaluation.md shows each."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from panoloc.core.camera.rig import Panorama, Rig
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.reader import read_panorama
from panoloc.core.options import IndexOptions
from panoloc.core.scan.reading import read_scan
from panoloc.lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError, known_pose
from panoloc.lab.rooms.capture.shooting import turned

# The names of the paper's table 1, whose splits are those with changes.
_PAPER_NAMES = {"robot": "change_robot", "handheld": "change_handheld"}
_STANFORD_IMAGE = re.compile(r"camera_[0-9a-zA-Z]+_(?P<room>[A-Za-z]+_\d+)_frame_equirectangular_domain_rgb\.png")


def dataset_scans(name: str, root: Path, split: str | None = None) -> list[ScanCases]:
    """Return the scans of a data set with their panoramas; `split` narrows them, None takes all.

    Raises OptionsError for an unknown data set or split, SourceError when the folder is not laid out as expected.
    """
    if name not in DATASETS:
        raise OptionsError(f"dataset: expected one of {', '.join(DATASETS)}, got {name!r}")
    if not root.is_dir():
        raise SourceError(f"{root}: expected the folder of {name}, found none")
    return DATASETS[name](root, split)


def omniscenes(root: Path, split: str | None = None) -> list[ScanCases]:
    """Return one scan per split and room of OmniScenes (Kim et al., ICCV 2021 and ECCV 2022), as the paper's implementation reads it.

    <split>_pano/<device>_<room>_<number>_scene_<k>/*.jpg      change_robot, change_handheld, robot, handheld, extreme, …
    <split>_pose/<device>_<room>_<number>_scene_<k>/*.txt      [R | position], 3 x 4 or 4 x 4
    pcd/<room>_<number>.txt                                    x y z red green blue

    split: a folder's name without `_pano`; None for all. `robot` and `handheld` are the splits with changes where those exist.
    """
    found = tuple(sorted(folder.name.removesuffix("_pano") for folder in root.glob("*_pano") if folder.is_dir()))
    if not found:
        raise SourceError(
            f"{root}: expected folders such as change_robot_pano and extreme_pano (docs/evaluation.md), found none"
        )
    named = _PAPER_NAMES.get(split or "")
    wanted = named if named in found else split
    return [scan for one in _chosen(wanted, found, "omniscenes") for scan in _omniscenes_scans(root, one)]


def _omniscenes_scans(root: Path, split: str) -> list[ScanCases]:
    rooms: dict[str, list[str]] = {}
    for video in sorted(path for path in (root / f"{split}_pano").iterdir() if path.is_dir()):
        parts = video.name.split("_")
        if len(parts) < 3:
            raise SourceError(f"{video}: expected a folder named <device>_<room>_<number>_scene_<k>")
        rooms.setdefault(f"{parts[1]}_{parts[2]}", []).extend(f"{video.name}/{name}" for name in _images_in(video))
    return [
        ScanCases(
            name=f"omniscenes/{split}/{room}",
            group=f"omniscenes {split}",
            query_names=tuple(names),
            load=lambda room=room: _load_omniscenes(root, split, room),  # type: ignore[misc]
            place=room,
        )
        for room, names in rooms.items()
    ]


def _load_omniscenes(root: Path, split: str, room: str) -> LoadedScan:
    def query(name: str) -> KnownQuery:
        """Read a panorama and its pose."""
        pose = _camera_from_map_pose((root / f"{split}_pose" / name).with_suffix(".txt"))
        panorama = read_panorama((root / f"{split}_pano" / name).read_bytes())
        return KnownQuery(Rig.of_panorama(panorama), (pose,), tags=(split,))

    scan = root / "pcd" / f"{room}.txt"
    if not scan.is_file():
        raise SourceError(f"{scan}: expected the cloud of {room}, x y z red green blue by line")
    return LoadedScan(read_scan(scan), IndexOptions(), query)


@dataclass(frozen=True)
class _Area:
    """Where the files of one area are."""

    name: str
    images: Path
    poses: Path
    root: Path


def stanford(root: Path, split: str | None = None) -> list[ScanCases]:
    """Return one scan per area and room of Stanford 2D-3D-S (Armeni et al., 2017), as published or as the paper's implementation reads it.

    split: `area_1` to `area_6`, None for all that are there.
    """
    areas = [_Area(f.parent.parent.name, f, f.parent / "pose", root) for f in sorted(root.glob("area_*/pano/rgb"))]
    areas += [_Area(f.name, f, root / "pose" / f.name, root) for f in sorted(root.glob("pano/area_*"))]
    if not areas:
        raise SourceError(f"{root}: expected area_<n>/pano/rgb or pano/area_<n> (docs/evaluation.md), found neither")
    names = _chosen(split, tuple(area.name for area in areas), "stanford2d3ds")
    return [scan for area in areas if area.name in names for scan in _stanford_scans(area)]


def _stanford_scans(area: _Area) -> list[ScanCases]:
    rooms: dict[str, list[str]] = {}
    for name in _images_in(area.images):
        match = _STANFORD_IMAGE.fullmatch(name)
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
            load=lambda room=room: _load_stanford(area, room),  # type: ignore[misc]
            place=f"{area.name}/{room}",
        )
        for room, names in sorted(rooms.items())
    ]


def _load_stanford(area: _Area, room: str) -> LoadedScan:
    def query(name: str) -> KnownQuery:
        """Read a panorama and its pose."""
        pose = _stanford_pose(area.poses / name.replace("_rgb.png", "_pose.json"))
        panorama = _without_black_poles(read_panorama((area.images / name).read_bytes()))
        return KnownQuery(Rig.of_panorama(panorama), (pose,), tags=(area.name,))

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


def _stanford_pose(path: Path) -> Pose:
    """Return map_from_camera of a pose file.

    camera_rt_matrix maps world to a camera with x right, y down, z forward. final_camera_rotation holds Euler angles about the fixed
    axes x, y, z of a camera with x right, y up, z back. Both describe the same camera, whose forward is the centre of the image.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if "camera_location" in values and "final_camera_rotation" in values:
            right, up, back = turned(*np.asarray(values["final_camera_rotation"], np.float64)[::-1]).T
            return known_pose(
                np.stack((-back, -right, up), axis=1), np.asarray(values["camera_location"], np.float64), path
            )
        matrix = np.asarray(values["camera_rt_matrix"], np.float64)[:3]
        right, down, forward = matrix[:, :3]
        return known_pose(np.stack((forward, -right, -down), axis=1), -matrix[:, :3].T @ matrix[:, 3], path)
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise SourceError(
            f"{path}: expected JSON with camera_location and final_camera_rotation, or camera_rt_matrix ({error!r})"
        ) from error


def _camera_from_map_pose(path: Path) -> Pose:
    """Return map_from_camera of a text file with [R | position], 3 x 4 or 4 x 4, where x_camera = R (x_map − position).

    That is the convention of the paper's reference implementation, whose camera axes are x forward, y left, z up as here.
    Raises SourceError when the file is missing or holds something else.
    """
    try:
        matrix = np.loadtxt(path, dtype=np.float64, ndmin=2)
    except (OSError, ValueError) as error:
        raise SourceError(
            f"{path}: expected a text file with a 3 x 4 or 4 x 4 matrix [R | position] ({error})"
        ) from error
    if matrix.shape not in ((3, 4), (4, 4)):
        raise SourceError(f"{path}: expected a 3 x 4 or 4 x 4 matrix [R | position], got {matrix.shape}")
    return known_pose(matrix[:3, :3].T, matrix[:3, 3], path)


def _images_in(folder: Path) -> tuple[str, ...]:
    """Return the names of the images of a folder, sorted."""
    return tuple(
        sorted(path.name for path in folder.iterdir() if path.suffix.lower() in (".jpg", ".jpeg", ".png", ".webp"))
    )


def _without_black_poles(panorama: Panorama) -> Panorama:
    """Return the panorama with the rows that are black from a pole on marked as missing: scanners do not see straight up and down."""
    dark = panorama.color.max(axis=(1, 2)) == 0
    missing = np.logical_and.accumulate(dark) | np.logical_and.accumulate(dark[::-1])[::-1]
    if missing.all():
        return panorama
    return Panorama(panorama.color, panorama.valid & ~missing[:, None])


def _chosen(split: str | None, known: tuple[str, ...], dataset: str) -> tuple[str, ...]:
    """Return the splits to read: `split`, or all; raises OptionsError for an unknown one."""
    if split is None:
        return known
    if split not in known:
        raise OptionsError(f"split: {dataset} has {', '.join(known) or 'none here'}; got {split!r}")
    return (split,)


DATASETS: Mapping[str, Callable[[Path, str | None], list[ScanCases]]] = {
    "omniscenes": omniscenes,
    "stanford2d3ds": stanford,
}
