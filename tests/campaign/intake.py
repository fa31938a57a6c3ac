"""Scans of rooms and flats with mixed-up units, axes, coordinate systems and heights: right, asked about, or silently wrong?"""

import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, get_args

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import NDArray
from pye57 import E57
from pyproj import CRS

from panoloc.core.options import METRES_PER_UNIT, ScanOptions, Unit, UpAxis
from panoloc.core.scan.frame import ScanFrame
from panoloc.core.scan.point_cloud import PointCloud
from panoloc.core.scan.reading import read_scan
from panoloc.lab.rooms import SceneSpec, build_scene, scan_scene
from tests.campaign.outcome import Outcome

Array = NDArray[np.float64]
Format = Literal["ply", "las", "laz", "e57", "xyz", "pcd", "obj"]
Verdict = Literal["right", "asked", "unanswerable", "silently wrong"]

_POINTS = 60_000
_LEAST_RIGHT = 0.8
_TOLERANCE_M = 0.01
# Where scans with a coordinate system lie: metres east and north, and the system by the unit of its grid.
_SYSTEMS: dict[Unit, tuple[str, tuple[float, float]]] = {
    "m": ("EPSG:25832", (640_000.0, 5_320_000.0)),
    "us-ft": ("EPSG:2230", (1_920_000.0, 560_000.0)),
}


@dataclass(frozen=True)
class Mixed:
    """One scan of the campaign. system: whether its file names one. seed: of the room and of everything drawn."""

    seed: int
    kind: str
    format: Format
    unit: Unit
    height_unit: Unit
    up_axis: UpAxis
    system: bool

    @property
    def frame(self) -> ScanFrame:
        """Return what reading has to find."""
        return ScanFrame(METRES_PER_UNIT[self.unit], METRES_PER_UNIT[self.height_unit], self.up_axis)


def drawn(seed: int) -> Mixed:
    """Return a scan at random: half of the files are in metres with z up, or say what they are in."""
    rng = np.random.default_rng((seed, 41))
    kind = str(rng.choice(["room", "flat", "bare"], p=[0.65, 0.3, 0.05]))
    form: Format = str(rng.choice(get_args(Format)))  # type: ignore[assignment]
    if form in ("las", "laz") and rng.random() < 0.6:
        unit: Unit = str(rng.choice(["m", "us-ft"]))  # type: ignore[assignment]
        odd: Unit = {"m": "us-ft", "us-ft": "m"}[unit]  # type: ignore[assignment]
        return Mixed(seed, kind, form, unit, odd if rng.random() < 0.25 else unit, "z", True)
    unit = "m" if form == "e57" else str(rng.choice(["m", "cm", "mm", "ft", "us-ft"], p=[0.4, 0.15, 0.2, 0.15, 0.1]))  # type: ignore[assignment]
    up_axis: UpAxis = str(rng.choice(["z", "y", "-y", "-z"], p=[0.45, 0.25, 0.15, 0.15]))  # type: ignore[assignment]
    height_unit: Unit = "ft" if (unit, up_axis) == ("m", "z") and rng.random() < 0.2 else unit
    return Mixed(seed, kind, form, unit, height_unit, up_axis, False)


def written(scan: Mixed, folder: Path) -> tuple[Path, Array]:
    """Write a scan and return its file, and where its points are in metres, z up, in the order of the file."""
    cloud = scan_scene(build_scene(SceneSpec(scan.kind, scan.seed)), num_points=_POINTS, seed=scan.seed)  # type: ignore[arg-type]
    rng = np.random.default_rng((scan.seed, 43))
    yaw = float(rng.choice([0.0, rng.uniform(0, 2 * np.pi)]))
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    truth = cloud.positions.astype(np.float64) @ turn.T
    if scan.system:
        truth += [*_SYSTEMS[scan.unit][1], 120.0]
    # The frame of the file: its columns are those of a rotation, exactly.
    back = scan.frame.to_map(np.eye(3))
    path = folder / f"scan.{scan.format}"
    _write(path, scan, truth @ np.linalg.inv(back), cloud)
    return path, truth


def _write(path: Path, scan: Mixed, positions: Array, cloud: PointCloud) -> None:
    table = [
        (*map(repr, position), *map(str, color))
        for position, color in zip(positions.tolist(), cloud.colors.tolist(), strict=True)
    ]
    if scan.format in ("las", "laz"):
        header = laspy.LasHeader(point_format=7, version="1.4")
        header.scales, header.offsets = np.full(3, 1e-4), np.floor(positions.min(axis=0))
        las = laspy.LasData(header)
        las.x, las.y, las.z = positions.T
        las.red, las.green, las.blue = cloud.colors.T.astype(np.uint16) * 257
        if scan.system:
            header.vlrs.append(WktCoordinateSystemVlr(CRS(_SYSTEMS[scan.unit][0]).to_wkt("WKT1_GDAL")))
        las.write(path)
    elif scan.format == "e57":
        file = E57(str(path), mode="w")
        columns: dict[str, Any] = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), positions.T.copy(), strict=True))
        columns |= dict(zip(("colorRed", "colorGreen", "colorBlue"), cloud.colors.T.copy(), strict=True))
        file.write_scan_raw(columns)
        file.close()
    else:
        heads = {
            "ply": f"ply\nformat ascii 1.0\nelement vertex {len(table)}\n"
            + "".join(f"property double {axis}\n" for axis in "xyz")
            + "".join(f"property uchar {color}\n" for color in ("red", "green", "blue"))
            + "end_header\n",
            "pcd": "VERSION .7\nFIELDS x y z r g b\nSIZE 8 8 8 1 1 1\nTYPE F F F U U U\nCOUNT 1 1 1 1 1 1\n"
            f"WIDTH {len(table)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(table)}\nDATA ascii\n",
        }
        start = "v " if scan.format == "obj" else ""
        path.write_text(heads.get(scan.format, "") + "".join(f"{start}{' '.join(row)}\n" for row in table))


def is_right(found: PointCloud, truth: Array) -> bool:
    """Tell whether a cloud has the size, the place and the vertical of the truth; a turn about the vertical is no mistake."""
    positions = found.positions.astype(np.float64) + found.origin_offset
    if len(positions) != len(truth):
        return False
    heights = np.abs(positions[:, 2] - truth[:, 2]).max()
    moved = [cloud[:, :2] - cloud[:, :2].mean(axis=0) for cloud in (positions, truth)]
    u, _, v = np.linalg.svd(moved[0].T @ moved[1])
    u[:, -1] *= np.linalg.det(u @ v)
    off = np.abs(moved[0] @ (u @ v) - moved[1]).max()
    return bool(max(heights, off) < _TOLERANCE_M)


def is_answerable(path: Path, truth: Array, found: PointCloud, patch: dict[str, Any] | None = None) -> bool:
    """Tell whether answering the questions leads to the truth. patch: the answers so far."""
    for question in (each.question for each in found.diagnostics if each.question):
        for choice in question["choices"]:
            answers = {**(patch or {}), **choice["patch"]}
            again = read_scan(path, ScanOptions(**answers))
            if is_right(again, truth) or (
                len(answers) < 4 and patch is None and is_answerable(path, truth, again, answers)
            ):
                return True
    return False


def verdict_on(scan: Mixed) -> tuple[Verdict, str]:
    """Return what became of a scan, and which questions were asked."""
    with TemporaryDirectory() as folder:
        path, truth = written(scan, Path(folder))
        found = read_scan(path)
        questions = [each for each in found.diagnostics if each.question]
        right = is_right(found, truth)
        if not questions:
            return "right" if right else "silently wrong", ""
        codes = ", ".join(each.code for each in questions)
        if right:
            return "asked", f"{codes}; right as it was"
        return ("asked" if is_answerable(path, truth, found) else "unanswerable"), codes


def intake(num_scans: int, seed: int) -> Outcome:
    """Read scans of rooms that no rule was made with, and count what became of them."""
    outcome, began, verdicts = Outcome("intake"), time.monotonic(), Counter[str]()
    for number in range(num_scans):
        scan = drawn(1000 * seed + number)
        verdict, asked = verdict_on(scan)
        verdicts[verdict] += 1
        outcome.cases += 1
        if verdict != "right":
            print(verdict, asked, scan, flush=True)
        if verdict in ("silently wrong", "unanswerable"):
            outcome.faults.append(f"{verdict}: {scan}")
    outcome.seconds = time.monotonic() - began
    outcome.figures = {verdict: str(verdicts[verdict]) for verdict in get_args(Verdict)}
    if verdicts["right"] < _LEAST_RIGHT * num_scans:
        outcome.faults.append(
            f"{verdicts['right']} of {num_scans} right without a question; expected {_LEAST_RIGHT:.0%}"
        )
    return outcome
