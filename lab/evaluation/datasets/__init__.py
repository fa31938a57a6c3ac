"""The paper's data sets in the layouts they are published in (docs/evaluation.md shows each)."""

from lab.evaluation.datasets.published import DATASETS, dataset_scans

__all__ = ["DATASETS", "dataset_scans"]
