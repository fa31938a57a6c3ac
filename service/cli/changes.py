"""`panoloc changes`: list what changed since a map's scan, or write a report of it."""

from pathlib import Path
from typing import Annotated
from urllib.parse import quote, urlencode

import typer
from rich.table import Table

from panoloc.core.options import ReportFormat
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.progress import show_waiting
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from panoloc.service.client import JsonObject

_LOOKING = "looking for what changed"
_LONGEST_S = 1800.0  # a minute for some ten photos, on a machine that does nothing else


def changes(
    ctx: typer.Context,
    map_id: Annotated[str, typer.Argument(metavar="MAP", help="Id of the map.")],
    format: Annotated[
        ReportFormat | None, typer.Option(help="Write a report with plan, list and pictures instead of a list.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            dir_okay=False, help="File of the report, with the ending of its format; default: MAP-changes.FORMAT."
        ),
    ] = None,
    since: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="Only photos from then on: 2026-11-21 (UTC) or 2026-11-21T12:00:00Z."),
    ] = None,
    until: Annotated[str | None, typer.Option(metavar="TIME", help="Only photos up to then, a day included.")] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """List the objects that came, went or moved since the scan, or write a report of them."""
    session = Session.of(ctx, json)
    if out is not None and format is None:
        raise typer.BadParameter("expected together with --format, got none; add --format html", param_hint="--out")
    # .bcf and .htm are usual too.
    if out is not None and format is not None and not (out.suffix and _ending(format).startswith(out.suffix.lower())):
        message = f"expected a file that ends in {_ending(format)}, got {out}, which may be a report of another format"
        raise typer.BadParameter(f"{message}; name it {out.with_suffix(_ending(format))}", param_hint="--out")
    query = {name: text for name, text in (("since", since), ("until", until)) if text is not None}
    path = f"/maps/{quote(map_id, safe='')}/changes"
    with session.client(url) as client:
        if format is not None:
            file = out or Path(f"{map_id}-changes{_ending(format)}")
            with show_waiting(session.messages, _LOOKING):
                report = client.fetch(f"{path}/report?{urlencode({**query, 'format': format})}", _LONGEST_S)
            file.write_bytes(report)
            session.show({"file": str(file)}, f"wrote {file}")
            return ExitCode.OK
        with show_waiting(session.messages, _LOOKING):
            found = client.fetch_json(f"{path}?{urlencode(query)}" if query else path, _LONGEST_S)
    if json:
        session.print_json(found)
    elif found["objects"]:
        session.results.print(_table(found["objects"]))
    elif found["num_photos"]:
        session.messages.print(f"No object that changed was found in {found['num_photos']} photos.")
    elif query:
        session.messages.print("No photos are kept from this period to look for objects in.")
    else:
        session.messages.print(
            "No photos are kept to look for objects in; place some with panoloc place.", markup=False
        )
    return ExitCode.OK


def _ending(format: ReportFormat) -> str:
    return ".bcfzip" if format == "bcf" else f".{format}"


def _table(objects: list[JsonObject]) -> Table:
    table = Table("object", "change", "place x, y, z (m)", "size (m)", "certainty", "photos", box=None)
    for each in objects:
        place = ", ".join(f"{value:.2f}" for value in each["center_m"])
        if each["from_m"] is not None:
            place += " from " + ", ".join(f"{value:.2f}" for value in each["from_m"])
        size = " x ".join(f"{value:.2f}" for value in each["size_m"])
        kind = each["kind"] if each["is_sure"] else f"{each['kind']}?"
        table.add_row(each["id"], kind, place, size, f"{each['certainty']:.0%}", str(each["num_photos"]))
    return table
