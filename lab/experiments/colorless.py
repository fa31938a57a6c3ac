"""`python -m lab.experiments.colorless CASES...`: can a photo be found in a scan without colours?

Takes the colours away from the scans of case folders and puts a grey in their place that a scanner without a camera could have, makes the
photos alike, and counts how many level panoramas are found. An experiment: the service refuses scans without colours.
"""

import argparse
import io
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageFilter

from core.geometry.pose import Pose, pose_error
from core.index.map_builder import build_map_index
from core.localizer import Localizer
from core.panorama.reader import read_panorama
from core.scan.point_cloud import PointCloud
from core.scan.reading import read_scan

Grey = NDArray[np.float64]

_VOXEL_M = 0.12  # of the neighbourhood in which a surface is flat or not
_FEWEST = 6  # points of a voxel whose surface has a direction
_WITHIN_M, _WITHIN_DEG = 0.3, 10.0


def luminance(cloud: PointCloud) -> Grey:
    """Return an intensity as good as it can be, 0..1: the brightness of what the camera saw."""
    return np.asarray(cloud.colors @ np.array([0.299, 0.587, 0.114]) / 255)


def reflectance(cloud: PointCloud) -> Grey:
    """Return an intensity as lasers have it, 0..1: of a wavelength at which colours are others, and weaker with the distance."""
    mixed = np.clip(cloud.colors / 255 @ np.array([0.9, -0.3, 0.4]), 0, None)
    middle = cloud.positions.mean(axis=0)
    distance = np.linalg.norm(cloud.positions - middle, axis=1)
    noise = np.random.default_rng(0).normal(0, 0.05, len(cloud))
    return np.asarray(np.clip(mixed**0.7 / (1 + distance / 10) + noise, 0, 1))


def edges_of_shape(cloud: PointCloud) -> Grey:
    """Return 1 where the surface is flat, 0 where it turns: edges, corners, small things."""
    return 1 - np.clip(_surface(cloud)[1] / 0.15, 0, 1)


def shading(cloud: PointCloud) -> Grey:
    """Return the brightness of surfaces in the light of a lamp above, 0..1, darker where they turn."""
    normals, bend = _surface(cloud)
    light = np.abs(normals @ np.array([0.3, 0.5, 0.81]))
    return np.asarray((0.25 + 0.75 * light) * (1 - 0.5 * np.clip(bend / 0.15, 0, 1)))


def _surface(cloud: PointCloud) -> tuple[NDArray[np.float64], Grey]:
    """Return the normal (N, 3) and the share of the spread along it (N,), 0 of a plane, of the voxel around each point."""
    cells = np.floor(cloud.positions / _VOXEL_M).astype(np.int64)
    _, cell, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    cell = cell.ravel()
    points = cloud.positions.astype(np.float64)
    means = np.stack([np.bincount(cell, points[:, axis]) for axis in range(3)], axis=1) / counts[:, None]
    offset = points - means[cell]
    spread = np.zeros((len(counts), 3, 3))
    for row in range(3):
        for column in range(3):
            spread[:, row, column] = np.bincount(cell, offset[:, row] * offset[:, column])
    along, directions = np.linalg.eigh(spread)
    bend = along[:, 0] / np.maximum(along.sum(axis=1), 1e-12)
    bend[counts < _FEWEST] = 0.0
    return directions[cell][:, :, 0], bend[cell]


def as_seen(photo: Image.Image) -> Image.Image:
    """Return the photo without its colours."""
    return photo.convert("L")


def edges_of_photo(photo: Image.Image) -> Image.Image:
    """Return white where the photo is smooth and black at its edges."""
    grey = np.asarray(photo.convert("L").filter(ImageFilter.GaussianBlur(2)), np.float64)
    down, across = np.gradient(grey)
    strength = np.hypot(down, across)
    strong = strength / max(float(np.quantile(strength, 0.97)), 1e-6)
    return Image.fromarray((255 * (1 - np.clip(strong, 0, 1))).astype(np.uint8))


KINDS: dict[str, tuple[Callable[[PointCloud], Grey], Callable[[Image.Image], Image.Image]]] = {
    "ideal intensity": (luminance, as_seen),
    "intensity of a laser": (reflectance, as_seen),
    "edges of shape": (edges_of_shape, edges_of_photo),
    "shading": (shading, as_seen),
}


def main(arguments: list[str]) -> int:
    """Print, for each kind of grey and each scan, how many level panoramas are found, and how many are told as such."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--kind", choices=KINDS, action="append", help="Only this grey; repeatable.")
    given = parser.parse_args(arguments)
    localizer = Localizer()
    torch.set_num_threads(1)
    for folder in given.cases:
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        queries = [each for each in truth["queries"] if "upright" in each["tags"]]
        cloud = read_scan(folder / truth["scans"][0])
        for name in given.kind or KINDS:
            grey_of, changed = KINDS[name]
            index = build_map_index(replace(cloud, colors=_grey_colors(grey_of(cloud))))
            found = [_found(localizer, index, folder, query, changed) for query in queries]
            right, sure = sum(is_right for is_right, _ in found), sum(is_sure for _, is_sure in found)
            both = sum(is_right and is_sure for is_right, is_sure in found)
            print(
                f"{folder.name}, {name}: {right} of {len(found)} right, {sure} localized, of them {both} right",
                flush=True,
            )
    return 0


def _grey_colors(grey: Grey) -> NDArray[np.uint8]:
    """Return colours (N, 3) of a grey (N,) in 0..1, with a trace of noise, as cameras have it."""
    noise = np.random.default_rng(1).integers(-3, 4, (len(grey), 3))
    return np.clip(255 * grey[:, None] + noise, 0, 255).astype(np.uint8)


def _found(
    localizer: Localizer, index: Any, folder: Path, query: dict[str, Any], changed: Callable[[Image.Image], Image.Image]
) -> tuple[bool, bool]:
    """Return whether a photo is found, and whether the answer says so."""
    out = io.BytesIO()
    with Image.open(folder / query["image"]) as photo:
        changed(photo.convert("RGB")).convert("RGB").save(out, "PNG")
    found = localizer.localize(read_panorama(out.getvalue()), [index])
    if found.best is None:
        return False, False
    error = pose_error(found.best.pose, Pose(np.array(query["rotation"]), np.array(query["position_m"])))
    return error.within(_WITHIN_M, _WITHIN_DEG), found.status == "localized"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
