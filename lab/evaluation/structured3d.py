"""Structured3D (Zheng et al., ECCV 2020), as published. The cloud is a panorama with its depth, the query the room with other furniture.

scene_<id>/2D_rendering/<room>/panorama/camera_xyz.txt                                     millimetres
scene_<id>/2D_rendering/<room>/panorama/<full|simple|empty>/depth.png                      millimetres, 0: no reading
scene_<id>/2D_rendering/<room>/panorama/<full|simple|empty>/rgb_<raw|warm|cold>light.png
"""

from itertools import product
from pathlib import Path

import numpy as np
from PIL import Image

from core.geometry.pose import Pose
from core.options import IndexOptions
from core.scan.point_cloud import PointCloud
from core.scan.voxel_thinning import thin_cloud
from lab.evaluation.dataset_files import chosen, read_image
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError
from lab.rooms.capture.spherical_camera import pixel_centers, viewing_directions

_FURNITURE, _LIGHTS = ("full", "simple", "empty"), ("raw", "warm", "cold")
SPLITS = tuple("-".join(parts) for parts in product(_FURNITURE, _FURNITURE, _LIGHTS))
DEFAULT_SPLITS = ("full-simple-raw", "full-empty-raw")
_MAX_POINTS = 500_000
# "The direction of the camera is always along the negative y-axis" names the seam of the image; its centre looks along +y.
_ROTATION = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def structured3d(root: Path, split: str | None = None) -> list[ScanCases]:
    """Return one scan per room; split: `<scan's furniture>-<query's furniture>-<query's light>`, such as `full-empty-warm`.

    None takes `full-simple-raw` and `full-empty-raw`. Scans are always in raw light. Rooms without the files of a split are left out.
    """
    rooms = sorted(path for path in root.glob("scene_*/2D_rendering/*/panorama") if path.is_dir())
    if not rooms:
        raise SourceError(f"{root}: expected scene_<id>/2D_rendering/<room>/panorama (docs/evaluation.md), found none")
    splits = DEFAULT_SPLITS if split is None else chosen(split, SPLITS, "structured3d")
    return [scan for one in splits for room in rooms if (scan := _scan_of(room, one)) is not None]


def _scan_of(room: Path, split: str) -> ScanCases | None:
    scanned, shown, light = split.split("-")
    color, depth = room / scanned / "rgb_rawlight.png", room / scanned / "depth.png"
    query = room / shown / f"rgb_{light}light.png"
    if not (color.is_file() and depth.is_file() and query.is_file()):
        return None
    scene, number = room.parts[-4], room.parts[-2]

    def load() -> LoadedScan:
        """Read the cloud, in metres, and the only query; raises SourceError for files that are not as published."""
        pose = _read_pose(room / "camera_xyz.txt")
        return LoadedScan(
            cloud_of_depth(color, depth, pose),
            IndexOptions(),
            lambda _: KnownQuery(read_image(query), (pose,), tags=(split,)),
        )

    return ScanCases(
        name=f"structured3d/{split}/{scene}/{number}",
        group=f"structured3d {split}",
        query_names=("panorama",),
        load=load,
        place=scene,
    )


def _read_pose(path: Path) -> Pose:
    try:
        position = np.loadtxt(path, dtype=np.float64).reshape(3)
    except (OSError, ValueError) as error:
        raise SourceError(f"{path}: expected three coordinates of the camera in millimetres ({error})") from error
    return Pose(_ROTATION, position / 1000)


def cloud_of_depth(color_file: Path, depth_file: Path, pose: Pose) -> PointCloud:
    """Return the cloud of a panorama with the distance of every pixel (16 bit, millimetres, 0 and 65535: none), in the frame of `pose`."""
    panorama = read_image(color_file)
    depth = np.asarray(Image.open(depth_file)).astype(np.float64)
    width = depth.shape[1]
    if depth.shape != panorama.valid.shape:
        raise SourceError(
            f"{depth_file}: expected a grey image of {panorama.valid.shape}, as {color_file.name}, got {depth.shape}"
        )
    directions = viewing_directions(*pixel_centers(width), width).reshape(*depth.shape, 3)
    measured = (depth > 0) & (depth < 65535) & panorama.valid
    if not measured.any():
        raise SourceError(f"{depth_file}: expected distances in millimetres, all are missing")
    positions = (depth[measured] / 1000)[:, None] * directions[measured] @ pose.rotation.T
    cloud = PointCloud(
        positions.astype(np.float32),
        np.ascontiguousarray(panorama.color[measured]),
        pose.position,
        num_points_read=int(measured.sum()),
    )
    return thin_cloud(cloud, _MAX_POINTS)
