"""What `panoloc evaluate campus` does once its options are known; imports the algorithm."""

from collections.abc import Sequence
from dataclasses import asdict
from json import dumps
from pathlib import Path

from rich.markup import escape

from panoloc.core.localizer import Localizer
from panoloc.lab.commands.evaluation_run import set_threads
from panoloc.lab.display import print_tables, table
from panoloc.lab.evaluation.campus import (
    Campus,
    campus_queries,
    campus_rows,
    campus_summary,
    read_vectors,
)
from panoloc.service.cli.session import Session


def run_campus(
    sizes: Sequence[int], num_queries: int, camera: str | None, device: str | None, out: Path, session: Session
) -> None:
    """Build what is missing of each campus, localize queries in it, and print and write the figures."""
    set_threads()
    localizer, figures = Localizer(device=device), []
    for num_maps in sizes:
        campus = Campus(out / "maps", num_maps)
        for number in range(num_maps):
            campus.build(number)
            if number % 50 == 0:
                session.messages.print(f"{num_maps} maps: {number} built")
        queries, vectors = list(campus_queries(campus, num_queries, camera)), read_vectors(campus)
        rows = list(campus_rows(campus, vectors, queries, localizer))
        figures.append(campus_summary(campus, vectors, rows))
        name = f"rows-{num_maps}-{camera or 'panorama'}.jsonl"
        (out / name).write_text("".join(dumps(asdict(row)) + "\n" for row in rows), encoding="utf-8")
    if session.json_output:
        session.print_json({"campus": figures})
    else:
        print_tables(session.results, [table(figures, 0)])
    session.messages.print(f"Rows of each query in {escape(str(out))}")
