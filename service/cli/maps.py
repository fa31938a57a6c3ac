"""`panoloc maps`: list, change, check, share and delete maps."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer
from rich.text import Text

from panoloc.core.options import UnitChoice, UpAxisChoice
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from panoloc.service.cli.tables import control_table, map_table, older_revision, words_here
from panoloc.service.client import ClientError, JsonClient, JsonObject, UnreachableError
from panoloc.service.host_names import is_loopback

app = typer.Typer(help="List, change, check, share or delete maps.")

MapIds = Annotated[list[str], typer.Argument(metavar="ID", help="Ids of the maps.")]


UnitOption = Annotated[
    UnitChoice | None,
    typer.Option(help="Unit of the scan's coordinates; auto: as the file says, else by the heights of its rooms."),
]
HeightUnitOption = Annotated[UnitChoice | None, typer.Option(help="Unit of the heights, where it is another one.")]
UpAxisOption = Annotated[
    UpAxisChoice | None,
    typer.Option(help="Axis of the scan that points up; auto: as the file says, else by floors and walls."),
]


@app.callback(invoke_without_command=True)
@app.command(name="list")
def list_maps(
    ctx: typer.Context,
    tag: Annotated[str | None, typer.Option(help="Only maps with this tag.")] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> None:
    """List, change, check, share or delete maps."""
    if ctx.invoked_subcommand is not None:
        return
    session = Session.of(ctx, json)
    with session.client(url) as client:
        places = list(client.list_maps(tag))
    if json:
        for place in places:
            session.print_json(place)
    elif places:
        session.results.print(map_table(places))
        for place in places:
            if place["status"] == "failed":
                session.results.print(_failure(place), markup=False)
        if lost := [place["id"] for place in places if place["status"] == "failed" and older_revision(place) is None]:
            session.messages.print(f"Delete what failed with: panoloc maps delete {' '.join(lost)}", markup=False)
    elif tag:
        session.messages.print(f"No map has the tag {tag}.", markup=False)
    else:
        session.messages.print("No maps yet. Register a scan with [bold]panoloc register SCAN[/].")


def _failure(place: JsonObject) -> str:
    reason, older = place["error"]["detail"], older_revision(place)
    if older is None:
        return f"{place['id']} failed: {reason}"
    return f"{place['id']}: revision {older} still answers, revision {place['revision']} failed: {reason}"


def question_words(place: JsonObject) -> list[str]:
    """Return what a map asks, with the command for every answer."""
    lines = []
    for found in (each for each in place["diagnostics"] if each.get("question")):
        lines.append(f"{found['message']} {found['question']['text']}")
        for choice in found["question"]["choices"]:
            height = choice["storey_height_m"]
            said = "" if height is None else f", storey of {height:.2f} m"
            options = " ".join(f"--{name.replace('_', '-')}={value}" for name, value in choice["patch"].items())
            lines.append(f"  {choice['label']}{said}: panoloc maps set {place['id']} {options}")
    return lines


@app.command(name="set")
def set_(
    ctx: typer.Context,
    map_ids: MapIds,
    name: Annotated[str | None, typer.Option(help="Display name.")] = None,
    unit: UnitOption = None,
    height_unit: HeightUnitOption = None,
    up_axis: UpAxisOption = None,
    coordinate_system: Annotated[
        str | None, typer.Option(help="Projected coordinate system, such as EPSG:25832; '' for that of the file.")
    ] = None,
    geoid_undulation: Annotated[
        float | None, typer.Option(metavar="METRES", help="Height of the geoid above the ellipsoid.")
    ] = None,
    wait: Annotated[bool, typer.Option(help="Wait until a scan that is read otherwise is a map again.")] = True,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Change maps without another upload. A scan that is read otherwise becomes a new revision; the old one answers until then."""
    session = Session.of(ctx, json)
    given = {
        "name": name,
        "unit": unit,
        "height_unit": height_unit,
        "up_axis": up_axis,
        "coordinate_system": coordinate_system,
        "geoid_undulation_m": geoid_undulation,
    }
    changes = {
        key: value or None if key == "coordinate_system" else value for key, value in given.items() if value is not None
    }
    if not changes:
        options = ", ".join(f"--{key.replace('_', '-').removesuffix('-m')}" for key in given)
        raise typer.BadParameter(f"expected what to change, got nothing; give at least one of {options}")

    def set_one(client: JsonClient, map_id: str) -> None:
        changed = client.change_map(map_id, changes)
        if wait and changed["status"] not in ("ready", "failed"):
            changed = client.wait_for_map(map_id)
        session.show(changed, f"{map_id} is changed")
        for words in question_words(changed):
            session.messages.print(words, markup=False, soft_wrap=True)

    return _for_each(session, url, map_ids, set_one)


@app.command()
def delete(ctx: typer.Context, map_ids: MapIds, url: UrlOption = DEFAULT_URL, json: JsonOption = False) -> int:
    """Delete maps with their scans and indexes. This cannot be undone."""
    session = Session.of(ctx, json)

    def delete_one(client: JsonClient, map_id: str) -> None:
        client.delete_map(map_id)
        session.show({"id": map_id, "deleted": True}, f"deleted {map_id}")

    return _for_each(session, url, map_ids, delete_one)


@app.command()
def share(
    ctx: typer.Context,
    map_ids: MapIds,
    tenants: Annotated[
        list[str] | None,
        typer.Option(
            "--with",
            metavar="TENANT",
            help="Tenant that gets access to the maps; repeatable, `*` for all, '' for nobody.",
        ),
    ] = None,
    qr: Annotated[
        bool,
        typer.Option("--qr", help="Make a link and a QR code for phones. Tenants change only together with --with."),
    ] = False,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="With --qr: the address under which phones reach the service; default: --url."
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Share the maps with exactly these tenants, with phones by a code, or with both.

    These tenants can view the maps and localize in them. Only the owner can change a map. With --qr people share them by a
    link, which names the address under which phones reach the service.
    """
    if tenants is None and not qr:
        raise typer.BadParameter(
            "expected with whom; name tenants (`*` for all, '' for nobody), or make a code for phones",
            param_hint="--with, --qr",
        )
    if at is not None and not at.lower().startswith(("http://", "https://")):
        raise typer.BadParameter(f"expected a URL with http:// or https://, got {at!r}", param_hint="--at")
    session = Session.of(ctx, json)

    def link_one(client: JsonClient, map_id: str) -> None:
        link = client.make_link(map_id, at)
        session.show({"id": map_id, "url": link["url"], "key_id": link["key_id"]}, link["url"])
        if not json:
            session.results.print(_qr_code(link["url"]))
            session.messages.print(_link_notes(link), markup=False, soft_wrap=True)

    def share_one(client: JsonClient, map_id: str) -> None:
        changed = client.change_map(map_id, {"shared_with": [name for name in tenants or () if name]})
        session.show(changed, f"{map_id} is shared with {', '.join(changed['shared_with']) or 'nobody'}")

    done = ExitCode.OK if tenants is None else _for_each(session, url, map_ids, share_one)
    return _for_each(session, url, map_ids, link_one) if qr and done == ExitCode.OK else done


@app.command("control-points")
def control_points(
    ctx: typer.Context,
    map_id: Annotated[str, typer.Argument(metavar="MAP", help="Id of the map.")],
    csv: Annotated[
        Path | None,
        typer.Argument(
            metavar="CSV",
            exists=True,
            dir_okay=False,
            help="Points with known coordinates: name, x, y, z or name, lat, lon, height, and map_x, map_y, map_z where the places in the "
            "scan are known. Without it, show the points that the map has.",
        ),
    ] = None,
    system: Annotated[
        str | None, typer.Option(metavar="EPSG", help="Coordinate system of x and y; default: that of the map.")
    ] = None,
    undulation: Annotated[
        float | None,
        typer.Option(
            "--geoid-undulation",
            metavar="METRES",
            help="Height of the geoid above the ellipsoid; default: that of the map.",
        ),
    ] = None,
    apply: Annotated[
        bool,
        typer.Option(
            "--apply", help="Give the map the place on Earth by which the points fit best, if none is found wrong."
        ),
    ] = False,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Check a map against control points: residuals and their root mean square, as it stands and after the best fit.

    The points of a CSV are stored with the map, in place of those it had. Places in the scan come from the CSV, or are clicked in the
    console under "Control points". --apply needs three or more of them.
    """
    session = Session.of(ctx, json)
    body: JsonObject | None = None
    if csv is not None:
        body = {
            "csv": _text_of(csv),
            "coordinate_system": system,
            "geoid_undulation_m": undulation,
        }
    elif system is not None or undulation is not None:
        raise typer.BadParameter(
            "expected together with a CSV, got none; name the file", param_hint="--system, --geoid-undulation"
        )
    with session.client(url) as client:
        try:
            report = client.control_points(map_id, body)
            found = (report["fit"] or {}).get("georeference")
            applies = bool(apply and found and not report["suspect"])
            if applies:
                stated = {} if undulation is None else {"geoid_undulation_m": undulation}
                client.change_map(map_id, {"georeference": found, **stated})
                report = client.control_points(map_id)
            # Coordinates of a grid need no georeference.
            compares = apply and not found and report["fit"] and report["as_is"]
            is_placed = bool(compares and client.get_map(map_id)["coordinate_system"])
        except ClientError as error:
            return session.show_failure(error, [map_id])
    session.show(report, control_table(report, is_applied=applies))
    if apply and not applies:
        wrong = f"{report['suspect']} is wrong, as said above; mend or remove it, and run again"
        why = words_here(wrong if found else report["no_georeference"])
        session.messages.print(f"The map is as it was: {why}.", markup=False)
        return ExitCode.OK if is_placed and not report["suspect"] else ExitCode.ERROR
    return ExitCode.ERROR if report["suspect"] else ExitCode.OK


def _text_of(csv: Path) -> str:
    data = csv.read_bytes()
    if b"\0" in data:
        raise typer.BadParameter(
            f"expected a table of text, got {csv}, which is none; export the points as CSV", param_hint="CSV"
        )
    return data.decode("utf-8-sig", "replace")


def _qr_code(text: str) -> Text:
    """Return the code in half blocks, dark on light in every terminal."""
    import segno

    drawn = io.StringIO()
    segno.make_qr(text).terminal(drawn, compact=True)
    return Text(drawn.getvalue(), style="white on black", no_wrap=True)


def _link_notes(link: JsonObject) -> str:
    """Return what the operator should know of a link: how its key ends, and whether phones can use it."""
    notes = []
    if link["key_id"]:
        notes.append(f"Whoever has the link can localize in this map until `panoloc keys revoke {link['key_id']}`.")
    address = urlsplit(link["url"])
    if is_loopback(address.hostname or ""):
        notes.append("Only this machine reaches that address: name one that phones reach with --at.")
    elif address.scheme != "https":
        notes.append("Phones allow the camera on https:// alone; `panoloc certificate` makes a certificate.")
    return "\n".join(notes)


def _for_each(
    session: Session, url: str, map_ids: Sequence[str], change: Callable[[JsonClient, str], None]
) -> ExitCode:
    """Change each distinct map, show failures at the end and return the exit code of the first.

    An unreachable service or an unknown key fails for all maps alike: the rest is then reported without a try.
    """
    distinct = list(dict.fromkeys(map_ids))
    failures: list[tuple[ClientError, list[str]]] = []
    with session.client(url) as client:
        for number, map_id in enumerate(distinct):
            try:
                change(client, map_id)
            except ClientError as error:
                is_of_all = isinstance(error, UnreachableError) or getattr(error, "status", None) == 401
                failures.append((error, distinct[number:] if is_of_all else [map_id]))
                if is_of_all:
                    break
    codes = [session.show_failure(error, ids) for error, ids in failures]
    return codes[0] if codes else ExitCode.OK
