"""The paper's data sets in the layouts that they are published in; docs/evaluation.md shows each."""

from collections.abc import Callable, Mapping
from pathlib import Path

from core.errors import OptionsError
from core.options import IndexOptions
from core.scan.reading import read_scan
from lab.evaluation.dataset_files import camera_from_map_pose, chosen, images_in, read_image
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError
from lab.evaluation.stanford import stanford
from lab.evaluation.structured3d import structured3d

# The names of the paper's table 1, whose splits are those with changes.
_PAPER_NAMES = {"robot": "change_robot", "handheld": "change_handheld"}


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
            load=lambda room=room: _load(root, split, room),  # type: ignore[misc]
            place=room,
        )
        for room, names in rooms.items()
    ]


def _load(root: Path, split: str, room: str) -> LoadedScan:
    def query(name: str) -> KnownQuery:
        """Read a panorama and its pose."""
        pose = camera_from_map_pose((root / f"{split}_pose" / name).with_suffix(".txt"))
        return KnownQuery(read_image(root / f"{split}_pano" / name), (pose,), tags=(split,))

    scan = root / "pcd" / f"{room}.txt"
    if not scan.is_file():
        raise SourceError(f"{scan}: expected the cloud of {room}, x y z red green blue by line")
    return LoadedScan(read_scan(scan), IndexOptions(), query)


DATASETS: Mapping[str, Callable[[Path, str | None], list[ScanCases]]] = {
    "omniscenes": omniscenes,
    "stanford2d3ds": stanford,
    "structured3d": structured3d,
}
