"""Procedural suites as a source of cases."""

import re
from collections.abc import Sequence
from typing import get_args

from core.errors import OptionsError
from core.options import ColorKind, IndexOptions
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases
from lab.evaluation.sources.photo_source import as_uploaded
from lab.rooms import suite_cases

_QUERY = "panorama"


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
    among = "-".join(families)

    def scan_of(seed: int) -> ScanCases:
        """Return the case of one seed under a name that no case of other sizes or families has."""
        name = f"{suite}-{seed}" + (f"-{among}" if among else "") + _sizes(width, num_points)
        return ScanCases(
            name=name,
            group=suite,
            query_names=(_QUERY,),
            load=lambda: _load(suite, seed, families, width, num_points, spacing_m),
            place=f"seed {seed}",  # suites of the same seed show the same rooms
            facts={**facts, "seed": seed},
        )

    return [scan_of(seed) for seed in seeds]


def _sizes(width: int, num_points: int | None) -> str:
    """Return what of a scan's name says that its sizes are not the usual ones."""
    return (f"-{width}px" if width != 1024 else "") + (f"-{num_points}pts" if num_points is not None else "")


def _load(
    suite: str, seed: int, families: Sequence[str], width: int, num_points: int | None, spacing_m: float | None
) -> LoadedScan:
    cases = suite_cases(suite, [seed], families=families or None, width=width, num_points=num_points)
    case = next(iter(cases))
    untold = case.missing_pixels is not None and case.panorama.valid[case.missing_pixels].any()
    query = KnownQuery(
        as_uploaded(case.panorama) if untold else case.query,
        (case.pose, *case.alternatives),
        case.changed_pixels,
        case.changed_points,
        ("procedural", case.color_kind),
        case.hints,
        case.lookalikes,
    )
    kinds: dict[str, ColorKind] = {kind: kind for kind in get_args(ColorKind)}
    # The paper's outdoor case: grid starts in a known cuboid (§4.2).
    options = IndexOptions("octree" if case.region is None else "grid", spacing_m, case.region, kinds[case.color_kind])
    return LoadedScan(case.cloud, options, lambda _: query)


def seed_range(text: str) -> list[int]:
    """Return the seeds that a text such as `1000-1019`, `7` or `1,3,5-8` names; raises OptionsError for anything else."""
    seeds: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"(\d+)(?:-(\d+))?", part.strip())
        if match is None or int(match[2] or match[1]) < int(match[1]):
            raise OptionsError(f"seeds: expected numbers and ranges such as 1000-1019 or 1,3,5-8, got {text!r}")
        seeds += range(int(match[1]), int(match[2] or match[1]) + 1)
    return seeds
