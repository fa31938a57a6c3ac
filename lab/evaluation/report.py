"""The report of an evaluation as a JSON-safe document: tables with everything that is needed to repeat them."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np

from lab.evaluation.methods import ComparedMethod
from lab.evaluation.ranking_metrics import reliability_bins
from lab.evaluation.rows import RIGHT, Row
from lab.evaluation.summary import Limits, Summary
from lab.machine import machine, versions


def report_document(
    found: Sequence[Summary],
    rows: Sequence[Row],
    methods: Sequence[ComparedMethod],
    limits: Sequence[Limits],
    command: Sequence[str],
) -> dict[str, Any]:
    """Return the tables, the reliability of the confidence by method, configurations with digests, machine, versions and command."""
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": list(command),
        "machine": machine(),
        "versions": versions(),
        "methods": {
            method.name: {"method": method.method, "digest": method.digest, "configuration": asdict(method.config)}
            for method in methods
        },
        "limits": [{"position_m": position, "orientation_deg": orientation} for position, orientation in limits],
        "summaries": [asdict(summary) for summary in found],
        "reliability": {method.name: _reliability(rows, method.name) for method in methods},
        "num_rows": len(rows),
    }


def _reliability(rows: Sequence[Row], method: str) -> list[dict[str, Any]]:
    answers = [row for row in rows if row.method == method and row.confidence is not None]
    confidences = np.array([row.confidence for row in answers], np.float64)
    right = np.array([row.within(RIGHT) for row in answers], bool)
    return [asdict(one) for one in reliability_bins(confidences, right)]
