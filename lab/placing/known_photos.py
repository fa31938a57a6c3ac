"""A folder of photos from several places with their poses: those of case folders, and of made-up flats."""

import json
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image

from core.geometry.pose import Pose
from core.scan.ply.writer import write_ply
from lab.rooms import SceneSpec, build_scene, sample_pose, scan_scene, take_panorama

_FLAT_POINTS = 500_000
_FLAT_PANORAMA_WIDTH = 1024
_JPEG_QUALITY = 92


@dataclass(frozen=True)
class KnownPhoto:
    """name: of the file below the folder of photos, with `/`. place: the stem of the scan that shows it. pose: map_from_camera there."""

    name: str
    place: str
    pose: Pose


@dataclass(frozen=True)
class KnownPhotos:
    """folder: of the photos, and of nothing else. scans: by place."""

    folder: Path
    scans: dict[str, Path]
    photos: tuple[KnownPhoto, ...]


def known_photos(
    folder: Path, cases: Sequence[Path], flat_seeds: Iterable[int], photos_of_flat: int, limit: int | None = None
) -> KnownPhotos:
    """Copy the panoramas of case folders, and make those of flats, `photos_of_flat` each, turned anyhow; limit: photos of each place.

    Of a case with several scans the first counts. Raises OSError for folders that are no cases.
    """
    scans: dict[str, Path] = {}
    photos: list[KnownPhoto] = []
    for case in cases:
        scans[case.name], found = _of_case(case, folder / "photos" / case.name)
        photos += islice(found, limit)
    for seed in flat_seeds:
        place = f"flat-{seed}"
        scans[place] = folder / f"{place}.ply"
        photos += _of_flat(seed, scans[place], folder / "photos" / place, min(photos_of_flat, limit or photos_of_flat))
    return KnownPhotos(folder / "photos", scans, tuple(photos))


def _of_case(case: Path, folder: Path) -> tuple[Path, Iterator[KnownPhoto]]:
    truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)

    def photos() -> Iterator[KnownPhoto]:
        for query in truth["queries"]:
            shutil.copyfile(case / query["image"], folder / query["image"])
            pose = Pose(np.asarray(query["rotation"]), np.asarray(query["position_m"]))
            yield KnownPhoto(f"{case.name}/{query['image']}", case.name, pose)

    return case / truth["scans"][0], photos()


def _of_flat(seed: int, scan: Path, folder: Path, num_photos: int) -> Iterator[KnownPhoto]:
    flat = build_scene(SceneSpec("flat", seed))
    folder.mkdir(parents=True, exist_ok=True)
    write_ply(scan, scan_scene(flat, num_points=_FLAT_POINTS, seed=seed))
    rng = np.random.default_rng((seed, 41))
    for number in range(num_photos):
        pose = sample_pose(flat, rng, "any")
        file = folder / f"{number:02}.jpg"
        Image.fromarray(take_panorama(flat, pose, _FLAT_PANORAMA_WIDTH).color).save(file, quality=_JPEG_QUALITY)
        yield KnownPhoto(f"{folder.name}/{file.name}", folder.name, pose)
