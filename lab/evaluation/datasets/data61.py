"""Data61/2D3D (Namin et al., 2015): outdoor panoramas and clouds with semantic labels as colours.

<scene>/pointcloud.ply (or .txt, .pcd)    x y z and the colour code of the label
<scene>/label/*.png                       equirectangular, the same colour codes
<scene>/pose/*.txt                        [R | position], 3 x 4 or 4 x 4, x_camera = R (x_map − position)
<scene>/region.txt (optional)             two lines, min and max x y z in metres, where cameras can be
"""

from pathlib import Path

import numpy as np

from core.options import IndexOptions, ScanOptions
from core.scan.reading import read_scan
from lab.evaluation.datasets.dataset_files import camera_from_map_pose, chosen, images_in, read_image
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError


def data61(root: Path, split: str | None = None) -> list[ScanCases]:
    """Return one scan per scene; split: a scene's name, None for all."""
    scenes = tuple(sorted(path.parent.name for path in root.glob("*/label") if path.is_dir()))
    if not scenes:
        raise SourceError(f"{root}: expected <scene>/label with panoramas of labels (docs/evaluation.md), found none")
    return [
        ScanCases(
            name=f"data61/{scene}",
            group="data61",
            query_names=images_in(root / scene / "label"),
            load=_Loader(root / scene),
            place=scene,
        )
        for scene in chosen(split, scenes, "data61")
    ]


class _Loader:
    """Loads one scene."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self) -> LoadedScan:
        clouds = sorted(self._folder.glob("pointcloud.*"))
        if not clouds:
            raise SourceError(f"{self._folder}: expected pointcloud.ply, .txt or .pcd with label colours")
        cloud = read_scan(clouds[0], ScanOptions(color_kind="labels"))
        # Paper, §4.2: starts on a grid in a known cuboid.
        return LoadedScan(cloud, IndexOptions("grid", region=self._region(), color_kind="labels"), self._query)

    def _region(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
        path = self._folder / "region.txt"
        if not path.exists():
            return None
        try:
            (x, y, z), (far_x, far_y, far_z) = np.loadtxt(path, dtype=np.float64).reshape(2, 3).tolist()
        except ValueError as error:
            raise SourceError(f"{path}: expected two lines with min and max x y z ({error})") from error
        return (x, y, z), (far_x, far_y, far_z)

    def _query(self, name: str) -> KnownQuery:
        pose = (self._folder / "pose" / name).with_suffix(".txt")
        return KnownQuery(read_image(self._folder / "label" / name), (camera_from_map_pose(pose),), tags=("labels",))
