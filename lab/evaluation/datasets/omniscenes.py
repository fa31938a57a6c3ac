"""OmniScenes (Kim et al., ICCV 2021 and ECCV 2022) in the layout of the paper's reference implementation.

<split>_pano/<device>_<room>_<number>_scene_<k>/*.jpg      change_robot, change_handheld, robot, handheld, extreme, …
<split>_pose/<device>_<room>_<number>_scene_<k>/*.txt      [R | position], 3 x 4 or 4 x 4
pcd/<room>_<number>.txt                                    x y z red green blue
"""

from pathlib import Path

from core.options import IndexOptions
from core.scan.reading import read_scan
from lab.evaluation.datasets.dataset_files import camera_from_map_pose, chosen, images_in, read_image
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError

# The names of the paper's table 1, whose splits are those with changes.
_PAPER_NAMES = {"robot": "change_robot", "handheld": "change_handheld"}


def omniscenes(root: Path, split: str | None = None) -> list[ScanCases]:
    """Return one scan per split and room. split: a folder's name without `_pano`; None for all.

    `robot` and `handheld` are the splits with changes where those exist, as in the paper.
    """
    found = tuple(sorted(folder.name.removesuffix("_pano") for folder in root.glob("*_pano") if folder.is_dir()))
    if not found:
        raise SourceError(
            f"{root}: expected folders such as change_robot_pano and extreme_pano (docs/evaluation.md), found none"
        )
    named = _PAPER_NAMES.get(split or "")
    wanted = named if named in found else split
    return [scan for one in chosen(wanted, found, "omniscenes") for scan in _scans_of(root, one)]


def _scans_of(root: Path, split: str) -> list[ScanCases]:
    rooms: dict[str, list[str]] = {}
    for video in sorted(path for path in (root / f"{split}_pano").iterdir() if path.is_dir()):
        parts = video.name.split("_")
        if len(parts) < 3:
            raise SourceError(f"{video}: expected a folder named <device>_<room>_<number>_scene_<k>")
        rooms.setdefault(f"{parts[1]}_{parts[2]}", []).extend(f"{video.name}/{name}" for name in images_in(video))
    return [
        ScanCases(
            name=f"omniscenes/{split}/{room}",
            group=f"omniscenes {split}",
            query_names=tuple(names),
            load=_Loader(root, split, room),
            place=room,
        )
        for room, names in rooms.items()
    ]


class _Loader:
    """Loads one room of one split."""

    def __init__(self, root: Path, split: str, room: str) -> None:
        self._root, self._split, self._room = root, split, room

    def __call__(self) -> LoadedScan:
        scan = self._root / "pcd" / f"{self._room}.txt"
        if not scan.is_file():
            raise SourceError(f"{scan}: expected the cloud of {self._room}, x y z red green blue by line")
        return LoadedScan(read_scan(scan), IndexOptions(), self._query)

    def _query(self, name: str) -> KnownQuery:
        pose = (self._root / f"{self._split}_pose" / name).with_suffix(".txt")
        return KnownQuery(
            read_image(self._root / f"{self._split}_pano" / name), (camera_from_map_pose(pose),), tags=(self._split,)
        )
