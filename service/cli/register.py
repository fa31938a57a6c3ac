"""`panoloc register`: upload a scan and wait until it can be localized in."""

from pathlib import Path
from typing import Annotated, Any

import typer

from core.options import ColorKind, ScanOptions, Unit, UpAxis
from service.cli.progress import show_registration, show_upload
from service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from service.cli.tables import map_summary
from service.client import ApiProblemError, JsonObject, PanolocClient, UnreachableError
from service.jobs import LONGEST_NAME


def register(
    ctx: typer.Context,
    scan: Annotated[
        Path,
        typer.Argument(
            metavar="SCAN", exists=True, dir_okay=False, readable=True, help="Coloured point cloud or mesh."
        ),
    ],
    name: Annotated[str | None, typer.Option(help="Name for people; the file's name when not given.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="Tag to find the map by; repeatable.")] = None,
    unit: Annotated[Unit, typer.Option(help="Unit of the scan's coordinates.")] = ScanOptions.unit,
    up_axis: Annotated[UpAxis, typer.Option(help="Axis of the scan that points up.")] = ScanOptions.up_axis,
    color_kind: Annotated[
        ColorKind, typer.Option(help="Photographic colours, or colour codes of semantic labels.")
    ] = ScanOptions.color_kind,
    coordinate_system: Annotated[
        str | None,
        typer.Option(
            help="Projected system of the scan's coordinates, such as EPSG:25832; read from LAS, LAZ and E57 that name it."
        ),
    ] = None,
    geoid_undulation: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Of the geoid above the ellipsoid there, so that heights of the coordinate system become heights of GeoPose.",
        ),
    ] = None,
    wait: Annotated[bool, typer.Option(help="Wait until the map is ready.")] = True,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> None:
    """Register a scan: upload it and build its map. Prints the map's id."""
    session: Session = ctx.obj
    session.json_output = json
    options: JsonObject = {
        "name": name or scan.stem[:LONGEST_NAME],
        "tags": tag or [],
        "unit": unit,
        "up_axis": up_axis,
        "color_kind": color_kind,
    }
    if coordinate_system is not None:
        options["coordinate_system"] = coordinate_system
    if geoid_undulation is not None:
        options["geoid_undulation_m"] = geoid_undulation
    with session.client(url) as client:
        place = upload_and_wait(session, client, scan, options, wait=wait)
    if json:
        session.print_json(place)
    else:
        session.results.print(map_summary(place))


def upload_and_wait(
    session: Session, client: PanolocClient, scan: Path, options: dict[str, Any], *, wait: bool
) -> JsonObject:
    """Upload with a progress bar; with `wait`, follow the registration until it is ready. Returns the map."""
    with show_upload(session.messages, scan.name) as progress:
        place = client.register_map(scan, options, progress)
    if not wait:
        return place
    if not session.messages.is_terminal:
        # No bar tells it there, and whoever gives up waiting should know what goes on without him.
        session.messages.print(
            f"Map {place['id']}: the scan is stored, its registration goes on in the service.", markup=False
        )
    try:
        with show_registration(session.messages) as on_update:
            return client.wait_for_map(place["id"], on_update)
    except ApiProblemError as problem:
        if problem.status != 403:
            raise
        # A key that may upload and not read: nothing went wrong, and who uploads again would have two maps.
        session.messages.print(
            f"Map {place['id']}: the scan is stored and goes on registering; this key may not read how far it is.",
            markup=False,
        )
        return place
    except (KeyboardInterrupt, UnreachableError) as end:
        goes_on = (
            "goes on registering" if isinstance(end, KeyboardInterrupt) else "is registered when the service runs again"
        )
        session.messages.print(
            f"Map {place['id']} {goes_on}: panoloc maps shows it, panoloc maps delete {place['id']} ends it.",
            markup=False,
        )
        raise
