"""`panoloc maps`: list the registered maps, share or delete some."""

from typing import Annotated

import typer

from service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from service.cli.tables import map_table

app = typer.Typer(help="List the registered maps, share or delete some.")


@app.callback(invoke_without_command=True)
def list_maps(
    ctx: typer.Context,
    tag: Annotated[str | None, typer.Option(help="Only maps that bear this tag.")] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> None:
    """List the registered maps, share or delete some."""
    if ctx.invoked_subcommand is not None:
        return
    session: Session = ctx.obj
    session.json_output = json
    with session.client(url) as client:
        places = list(client.list_maps(tag))
    if json:
        for place in places:
            session.print_json(place)
    elif places:
        session.results.print(map_table(places))
        for place in places:
            if place["status"] == "failed":
                reason = (place.get("error") or {}).get("detail", "see its error with --json")
                session.results.print(f"{place['id']} failed: {reason}", markup=False)
    else:
        session.messages.print("No maps yet. Register a scan with [bold]panoloc register SCAN[/].")


@app.command()
def delete(
    ctx: typer.Context,
    map_ids: Annotated[list[str], typer.Argument(metavar="ID", help="Ids of the maps to delete.")],
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> None:
    """Delete maps with their scans and indexes. There is no way back."""
    session: Session = ctx.obj
    session.json_output = json
    with session.client(url) as client:
        for map_id in dict.fromkeys(map_ids):  # a map named twice is deleted once
            client.delete_map(map_id)
            if json:
                session.print_json({"id": map_id, "deleted": True})
            else:
                session.results.print(f"deleted {map_id}")


@app.command()
def share(
    ctx: typer.Context,
    map_ids: Annotated[list[str], typer.Argument(metavar="ID", help="Ids of the maps to share.")],
    tenants: Annotated[
        list[str] | None,
        typer.Option(
            "--with", metavar="TENANT", help="Whose keys see them; repeat the option, `*` for all. None: nobody's."
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> None:
    """Let keys of these tenants see maps and localize in them, and no others than these. To change maps stays with their owner."""
    session: Session = ctx.obj
    session.json_output = json
    with session.client(url) as client:
        for map_id in dict.fromkeys(map_ids):
            changed = client.change_map(map_id, {"shared_with": tenants or []})
            if json:
                session.print_json(changed)
            else:
                told = ", ".join(changed["shared_with"]) or "nobody"
                session.results.print(f"{map_id} is shared with {told}", markup=False)
