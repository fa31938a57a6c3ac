"""Case folders as a source: a truth.json beside its scans and panoramas (`lab.rooms.write_case_folder` writes such folders)."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from core.geometry.pose import Pose
from core.options import IndexOptions, ScanOptions
from core.panorama.reader import read_panorama
from core.scan.reading import read_scan
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError


def folder_scans(root: Path, *, tags: tuple[str, ...] = ()) -> list[ScanCases]:
    """Return the scans of all truth.json in `root` and one level below, each with the queries that bear all `tags`.

    Raises SourceError when there is none, or one is not of the expected form.
    """
    truths = sorted([*root.glob("truth.json"), *root.glob("*/truth.json")])
    if not truths:
        raise SourceError(f"{root}: expected truth.json in it or in a folder below, found none")
    return [scan for truth in truths for scan in _scans_of(truth, tags)]


def _scans_of(truth_file: Path, tags: tuple[str, ...]) -> list[ScanCases]:
    folder = truth_file.parent
    try:
        truth = json.loads(truth_file.read_text(encoding="utf-8"))
        name, scans = str(truth.get("name", folder.name)), list(truth["scans"])
        queries = {str(entry["image"]): entry for entry in truth["queries"] if set(tags) <= set(entry.get("tags", ()))}
    except (ValueError, KeyError, TypeError) as error:
        raise SourceError(
            f"{truth_file}: expected scans and queries with image, position_m and rotation ({error!r})"
        ) from error
    return [
        ScanCases(
            name=name if len(scans) == 1 else f"{name}/{scan}",
            group=name,
            query_names=tuple(image for image, entry in queries.items() if entry.get("scan", scan) == scan),
            load=lambda scan=scan: _load(folder, scan, truth.get("color_kind", "rgb"), queries),  # type: ignore[misc]
            place=name,
        )
        for scan in scans
    ]


def _load(folder: Path, scan: str, color_kind: Any, queries: dict[str, dict[str, Any]]) -> LoadedScan:
    cloud = read_scan(folder / scan, ScanOptions(color_kind=color_kind))

    def query(image: str) -> KnownQuery:
        """Read the panorama of that file name with its pose; with what changed, where the folder has one query and says so."""
        entry = queries[image]
        pixels, points = folder / "changed_pixels.png", folder / "changed_points.npy"
        known_change = len(queries) == 1 and pixels.exists() and points.exists()
        gone = np.load(points) if known_change else None
        return KnownQuery(
            read_panorama((folder / image).read_bytes()),
            (Pose(np.asarray(entry["rotation"], np.float64), np.asarray(entry["position_m"], np.float64)),),
            np.asarray(Image.open(pixels).convert("L")) > 127 if known_change else None,
            # Thinning while reading changes which points there are.
            gone if gone is not None and len(gone) == len(cloud) else None,
            tuple(entry.get("tags", ())),
        )

    return LoadedScan(cloud, IndexOptions(color_kind=color_kind), query)
