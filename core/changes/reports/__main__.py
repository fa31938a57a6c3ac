"""`python -m panoloc.core.changes.reports DOCUMENT.json FORMAT TARGET`: write a report of changes; see `report.read_report`."""

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from panoloc.core.changes.reports.bcf import as_bcf
from panoloc.core.changes.reports.document import as_pdf
from panoloc.core.changes.reports.report import ChangeReport, read_report
from panoloc.core.changes.reports.tables import as_csv, as_geojson
from panoloc.core.changes.reports.web_page import as_html
from panoloc.core.options import ReportFormat
from panoloc.core.scan.reading import read_points_of_map

WRITERS: dict[ReportFormat, Callable[[ChangeReport], bytes]] = {
    "html": as_html,
    "pdf": as_pdf,
    "csv": as_csv,
    "geojson": as_geojson,
    "bcf": as_bcf,
}


def main(arguments: Sequence[str]) -> int:
    """Write one report and return the exit code."""
    document = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    report = read_report(document, read_points_of_map(Path(document["points"])))
    writer = next(write for name, write in WRITERS.items() if name == arguments[1])
    Path(arguments[2]).write_bytes(writer(report))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
