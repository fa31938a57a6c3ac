"""`panoloc register`: upload a scan and wait until it can be localized in."""

from pathlib import Path
from typing import Annotated

import typer

from panoloc.core.options import ColorKind, ScanOptions
from panoloc.service.cli.maps import HeightUnitOption, UnitOption, UpAxisOption, question_words
from panoloc.service.cli.progress import show_registration, show_upload
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from panoloc.service.cli.tables import map_summary
from panoloc.service.client import ApiProblemError, JsonClient, JsonObject, UnreachableError
from panoloc.service.jobs import LONGEST_NAME


def register(
    ctx: typer.Context,
    scan: Annotated[
        Path,
        typer.Argument(
            metavar="SCAN", exists=True, dir_okay=False, readable=True, help="Coloured point cloud or mesh."
        ),
    ],
    name: Annotated[str | None, typer.Option(help="Display name; default: the file name.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="Tag for finding the map; repeatable.")] = None,
    unit: UnitOption = None,
    height_unit: HeightUnitOption = None,
    up_axis: UpAxisOption = None,
    color_kind: Annotated[
        ColorKind, typer.Option(help="Photographic colours, or colours that encode semantic labels.")
    ] = ScanOptions.color_kind,
    coordinate_system: Annotated[
        str | None,
        typer.Option(
            help="Projected coordinate system of the scan, such as EPSG:25832; default: as named in a LAS, LAZ or "
            "E57 file."
        ),
    ] = None,
    geoid_undulation: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            help="Height of the geoid above the ellipsoid; converts heights above sea level to the ellipsoidal "
            "heights of GeoPose.",
        ),
    ] = None,
    wait: Annotated[bool, typer.Option(help="Wait until the map is ready.")] = True,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> None:
    """Register a scan: upload it and build its map. Prints the map's id."""
    session = Session.of(ctx, json)
    options: JsonObject = {
        "name": name or scan.stem[:LONGEST_NAME],
        "tags": tag or [],
        "unit": unit,
        "height_unit": height_unit,
        "up_axis": up_axis,
        "color_kind": color_kind,
        "coordinate_system": coordinate_system,
        "geoid_undulation_m": geoid_undulation,
    }
    options = {key: value for key, value in options.items() if value is not None}
    with session.client(url) as client:
        place = upload_and_wait(session, client, scan, options, wait=wait)
    session.show(place, map_summary(place))
    for words in question_words(place):
        session.messages.print(words, markup=False, soft_wrap=True)


def upload_and_wait(session: Session, client: JsonClient, scan: Path, options: JsonObject, *, wait: bool) -> JsonObject:
    """Upload with a progress bar; with `wait`, follow the registration until the map is ready. Returns the map."""
    with show_upload(session.messages, scan.name) as progress:
        place = client.register_map(scan, options, progress)
    if not wait:
        return place

    def tell(what: str) -> None:
        session.messages.print(f"Map {place['id']}{what}", markup=False)

    if not session.messages.is_terminal:
        # No bar shows it there, and whoever stops waiting needs the id.
        tell(": the scan is stored, and the service continues its registration.")
    manage = f"panoloc maps shows its state, panoloc maps delete {place['id']} cancels it."
    try:
        with show_registration(session.messages) as on_update:
            return client.wait_for_map(place["id"], on_update)
    except ApiProblemError as problem:
        if problem.status != 403:
            raise
        # A key that may upload but not read. It is no failure: a second upload would make a second map.
        tell(": the scan is stored and its registration continues; this key may not read its progress.")
        return place
    except KeyboardInterrupt:
        tell(f": its registration continues: {manage}")
        raise
    except UnreachableError:
        tell(f": its registration continues when the service runs again: {manage}")
        raise
