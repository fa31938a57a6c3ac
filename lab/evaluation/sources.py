"""Where cases come from: procedural suites, and case folders with a truth.json beside their scans and panoramas."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from panoloc.core.camera.rig import Rig
from panoloc.core.errors import OptionsError
from panoloc.core.geometry.pose import Pose
from panoloc.core.image.reader import read_panorama
from panoloc.core.options import IndexOptions, ScanOptions
from panoloc.core.scan.reading import read_scan
from panoloc.lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError, known_pose
from panoloc.lab.evaluation.photo_source import as_uploaded
from panoloc.lab.rooms import suite_cases


def suite_scans(
    suite: str,
    seeds: Sequence[int],
    *,
    families: Sequence[str] = (),
    width: int = 1024,
    num_points: int | None = None,
    spacing_m: float | None = None,
) -> list[ScanCases]:
    """Return one scan with one query per seed; nothing is made before it is loaded.

    families: style families to draw from, none for all. width: of the panorama, or of a photo, in pixels. num_points: of the scan,
    None for what the suite says. spacing_m: of the starts, None for the default.
    Raises OptionsError for an unknown suite or family.
    """
    suite_cases(suite, [], families=families or None)  # what is unknown is refused before anything is made
    facts = {"family": families[0]} if len(families) == 1 else {}
    among = f"-{'-'.join(families)}" if families else ""
    sizes = (f"-{width}px" if width != 1024 else "") + (f"-{num_points}pts" if num_points is not None else "")

    def load(seed: int) -> LoadedScan:
        """Make the case of a seed."""
        case = next(suite_cases(suite, [seed], families=families or None, width=width, num_points=num_points))
        is_unmasked = case.missing_pixels is not None and case.panorama.valid[case.missing_pixels].any()
        query = KnownQuery(
            Rig.of_panorama(as_uploaded(case.panorama)) if is_unmasked else case.query,
            (case.pose, *case.alternatives),
            case.changed_pixels,
            case.changed_points,
            ("procedural", case.color_kind),
            case.hints,
            case.aliases,
        )
        # The paper's outdoor case: grid starts in a known cuboid (§4.2).
        options = IndexOptions("octree" if case.region is None else "grid", spacing_m, case.region, case.color_kind)
        return LoadedScan(case.cloud, options, lambda _: query)

    return [
        ScanCases(
            # No case of other sizes or families has this name.
            name=f"{suite}-{seed}{among}{sizes}",
            group=suite,
            query_names=("panorama",),
            load=lambda seed=seed: load(seed),  # type: ignore[misc]
            place=f"seed {seed}",  # suites of the same seed show the same rooms
            facts={**facts, "seed": seed},
        )
        for seed in seeds
    ]


def seed_range(text: str) -> list[int]:
    """Return the seeds that a text such as `1000-1019`, `7` or `1,3,5-8` names; raises OptionsError for anything else."""
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", part.strip())
        if match is None or int(match[2] or match[1]) < int(match[1]):
            raise OptionsError(f"seeds: expected numbers and ranges such as 1000-1019 or 1,3,5-8, got {text!r}")
        seeds += range(int(match[1]), int(match[2] or match[1]) + 1)
    return seeds


def folder_scans(root: Path, *, tags: tuple[str, ...] = ()) -> list[ScanCases]:
    """Return the scans of all truth.json in `root` and one level below, each with the queries that bear all `tags`.

    Raises SourceError when there is none, or one is not of the expected form.
    """
    truths = sorted([*root.glob("truth.json"), *root.glob("*/truth.json")])
    if not truths:
        raise SourceError(f"{root}: expected truth.json in it or in a folder below, found none")
    scans = [scan for truth in truths for scan in _scans_of(truth, tags)]
    if tags and not any(scan.query_names for scan in scans):
        raise SourceError(f"{root}: expected queries with the tags {', '.join(tags)}, found none")
    return scans


@dataclass(frozen=True)
class _Entry:
    """One query of a truth.json: its file, the scan that it is of, None for each, its pose in the scan's own frame, and its tags."""

    image: str
    scan: str | None
    pose: Pose
    tags: tuple[str, ...]


def _scans_of(truth_file: Path, tags: tuple[str, ...]) -> list[ScanCases]:
    folder = truth_file.parent
    try:
        truth = json.loads(truth_file.read_text(encoding="utf-8"))
        name, scans = str(truth.get("name", folder.name)), [str(scan) for scan in truth["scans"]]
        kind = truth.get("color_kind", "rgb")
        entries = [_entry(entry, f"{truth_file}: queries[{k}]") for k, entry in enumerate(truth["queries"])]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SourceError(
            f"{truth_file}: expected scans and queries with image, position_m and rotation ({error!r})"
        ) from error
    for k, entry in enumerate(entries):
        if entry.scan not in (None, *scans):
            raise SourceError(
                f"{truth_file}: queries[{k}].scan: expected one of {', '.join(scans)}, got {entry.scan!r}"
            )
    missing = [file for file in (*scans, *(entry.image for entry in entries)) if not (folder / file).is_file()]
    if missing:
        raise SourceError(f"{truth_file}: expected its files beside it, did not find {', '.join(missing[:3])}")

    def cases(scan: str) -> ScanCases:
        """Return the cases of one scan."""
        own = [entry for entry in entries if entry.scan in (None, scan)]
        queries = {entry.image: entry for entry in own}
        if len(queries) < len(own):
            raise SourceError(f"{truth_file}: expected each image once for {scan}, found some twice")
        return ScanCases(
            name=name if len(scans) == 1 else f"{name}/{scan}",
            group=name,
            query_names=tuple(image for image, entry in queries.items() if set(tags) <= set(entry.tags)),
            load=lambda: _load(folder, scan, kind, queries),
            place=name,
        )

    return [cases(scan) for scan in scans]


def _entry(entry: Any, where: str) -> _Entry:
    rotation, position = np.asarray(entry["rotation"], np.float64), np.asarray(entry["position_m"], np.float64)
    if rotation.shape != (3, 3) or position.shape != (3,):
        raise SourceError(f"{where}: expected a rotation of 3 x 3 numbers and a position_m of three")
    pose = known_pose(rotation, position, where)
    return _Entry(str(entry["image"]), entry.get("scan"), pose, tuple(entry.get("tags", ())))


def _load(folder: Path, scan: str, color_kind: Any, queries: dict[str, _Entry]) -> LoadedScan:
    def query(image: str) -> KnownQuery:
        """Read the panorama of that file name with its pose."""
        entry = queries[image]
        return KnownQuery(Rig.of_panorama(read_panorama((folder / image).read_bytes())), (entry.pose,), tags=entry.tags)

    cloud = read_scan(folder / scan, ScanOptions(color_kind=color_kind))
    return LoadedScan(cloud, IndexOptions(color_kind=color_kind), query)
