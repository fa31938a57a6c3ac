"""The options of `panoloc evaluate`, in the panels and the order in which its help shows them."""

from pathlib import Path
from typing import Annotated, Any

import typer


def _source(*names: str, **rules: Any) -> Any:
    return typer.Option(*names, rich_help_panel="Cases", **rules)


def _method(*names: str, **rules: Any) -> Any:
    return typer.Option(*names, rich_help_panel="Methods", **rules)


def _output(*names: str, **rules: Any) -> Any:
    return typer.Option(*names, rich_help_panel="Output", **rules)


Suites = Annotated[list[str] | None, _source("--suite", help="Procedural suite; repeatable.")]
Seeds = Annotated[str, _source(help="Seeds of the suites: 1000-1019, or 1,3,5-8.")]
Families = Annotated[list[str] | None, _source("--family", help="Style family of the suites; repeatable.")]
Width = Annotated[int, _source(min=128, help="Pixels of a suite's panorama, or of a photo.")]
Cameras = Annotated[
    list[str] | None,
    _source("--camera", help="Photos in place of panoramas: photo, frames4, sweep, …; repeatable."),
]
Points = Annotated[int | None, _source(min=1000, help="Points of a suite's scan.")]
Cases = Annotated[list[Path] | None, _source(help="Folder with truth.json in it or one below; repeatable.")]
Tags = Annotated[list[str] | None, _source("--tag", help="Only queries of --cases with it.")]
Dataset = Annotated[str | None, _source(help="omniscenes, stanford2d3ds, structured3d or data61.")]
Root = Annotated[Path | None, _source(help="Folder of the data set.")]
Splits = Annotated[list[str] | None, _source("--split", help="Split of the data set; repeatable.")]
Limit = Annotated[int | None, _source(min=1, help="Queries per suite, case folder or split.")]

Methods = Annotated[
    list[str] | None,
    _method(
        "--method",
        help="fast, paper, paper-no-…, piccolo, or NAME=BASE:section.field=value; repeatable; fast and paper when left out.",
    ),
]
Device = Annotated[str | None, _method(help="cpu or cuda.")]
TimeoutS = Annotated[float | None, _method(min=0.1, help="Limit of one answer.")]
SpacingM = Annotated[float | None, _method(help="Metres between starts of suites.")]
Cross = Annotated[int, _method(min=0, help="Also send each panorama to this many other maps.")]
ChangeMaps = Annotated[bool, _method("--change-maps", help="Measure the maps of what changed.")]

Out = Annotated[Path, _output(file_okay=False, help="Folder of rows, report and plots.")]
Within = Annotated[list[str] | None, _output("--within", help="Limits such as 0.05,5 (m, deg); repeatable.")]
