"""Measuring methods on cases with known poses: procedural suites, case folders, and the paper's data sets.

Sources yield `ScanCases`; `Evaluation` runs methods on them and writes rows; `summaries` makes the paper's tables of rows, and
`fit_confidence` the coefficients of the confidence.
"""

from lab.evaluation.datasets import DATASETS, dataset_scans
from lab.evaluation.fit_confidence import ConfidenceFit, HeldOut, fit_confidence
from lab.evaluation.known_cases import KnownQuery, LoadedScan, ScanCases, SourceError, limited
from lab.evaluation.methods import METHOD_NAMES, ComparedMethod, compared_method
from lab.evaluation.photo_source import as_photos
from lab.evaluation.rows import Row, RowsError, RowsFile, read_rows
from lab.evaluation.runner import Evaluation, RunOptions
from lab.evaluation.sources import folder_scans, seed_range, suite_scans
from lab.evaluation.summary import DEFAULT_LIMITS, Summary, summaries

__all__ = [
    "DATASETS",
    "DEFAULT_LIMITS",
    "METHOD_NAMES",
    "ComparedMethod",
    "ConfidenceFit",
    "Evaluation",
    "HeldOut",
    "KnownQuery",
    "LoadedScan",
    "Row",
    "RowsError",
    "RowsFile",
    "RunOptions",
    "ScanCases",
    "SourceError",
    "Summary",
    "as_photos",
    "compared_method",
    "dataset_scans",
    "fit_confidence",
    "folder_scans",
    "limited",
    "read_rows",
    "seed_range",
    "suite_scans",
    "summaries",
]
