"""Which data sets can be read, by name."""

from collections.abc import Callable, Mapping
from pathlib import Path

from core.errors import OptionsError
from lab.evaluation.datasets.data61 import data61
from lab.evaluation.datasets.omniscenes import omniscenes
from lab.evaluation.datasets.stanford import stanford
from lab.evaluation.datasets.structured3d import structured3d
from lab.evaluation.known_cases import ScanCases, SourceError

Reader = Callable[[Path, str | None], list[ScanCases]]

DATASETS: Mapping[str, Reader] = {
    "omniscenes": omniscenes,
    "stanford2d3ds": stanford,
    "structured3d": structured3d,
    "data61": data61,
}


def dataset_scans(name: str, root: Path, split: str | None = None) -> list[ScanCases]:
    """Return the scans of a data set with their panoramas; `split` narrows them, None takes all.

    Raises OptionsError for an unknown data set or split, SourceError when the folder is not laid out as expected.
    """
    if name not in DATASETS:
        raise OptionsError(f"dataset: expected one of {', '.join(DATASETS)}, got {name!r}")
    if not root.is_dir():
        raise SourceError(f"{root}: expected the folder of {name}, found none")
    return DATASETS[name](root, split)
