"""`panoloc maps`: list the registered maps, share or delete some."""

from collections.abc import Callable, Sequence
from typing import Annotated

import typer

from service.cli.exit_codes import ExitCode
from service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from service.cli.tables import map_table, older_revision
from service.client import ApiProblemError, ClientError, JsonObject, UnreachableError

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
                session.results.print(f"{place['id']}{_what_failed(place)}: {reason}", markup=False)
    elif tag:
        session.messages.print(f"No map bears the tag {tag}.", markup=False)
    else:
        session.messages.print("No maps yet. Register a scan with [bold]panoloc register SCAN[/].")


def _what_failed(place: JsonObject) -> str:
    older = older_revision(place)
    if older is None:
        return " failed"
    return f": revision {older} still answers, revision {place['revision']} failed"


@app.command()
def delete(
    ctx: typer.Context,
    map_ids: Annotated[list[str], typer.Argument(metavar="ID", help="Ids of the maps to delete.")],
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Delete maps with their scans and indexes. There is no way back."""
    session: Session = ctx.obj
    session.json_output = json
    with session.client(url) as client:

        def delete_one(map_id: str) -> None:
            client.delete_map(map_id)
            if json:
                session.print_json({"id": map_id, "deleted": True})
            else:
                session.results.print(f"deleted {map_id}", markup=False)

        return _for_each(session, map_ids, delete_one)


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
) -> int:
    """Let keys of these tenants see maps and localize in them, and no others than these. To change maps stays with their owner."""
    session: Session = ctx.obj
    session.json_output = json
    with session.client(url) as client:

        def share_one(map_id: str) -> None:
            changed = client.change_map(map_id, {"shared_with": tenants or []})
            if json:
                session.print_json(changed)
            else:
                told = ", ".join(changed["shared_with"]) or "nobody"
                session.results.print(f"{map_id} is shared with {told}", markup=False)

        return _for_each(session, map_ids, share_one)


def _for_each(session: Session, map_ids: Sequence[str], change: Callable[[str], None]) -> ExitCode:
    """Call `change` with each id, once where it is named twice; show failures at the end and return the first one's exit code.

    What would fail for the rest in the same way, a service that is gone or a key that is none, is shown for them without being tried.
    """
    distinct = list(dict.fromkeys(map_ids))
    failures: list[tuple[ClientError, list[str]]] = []
    for number, map_id in enumerate(distinct):
        try:
            change(map_id)
        except ClientError as error:
            if _is_of_all_maps(error):
                failures.append((error, distinct[number:]))
                break
            failures.append((error, [map_id]))
    codes = [session.show_failure(error, ids) for error, ids in failures]
    return codes[0] if codes else ExitCode.OK


def _is_of_all_maps(error: ClientError) -> bool:
    return isinstance(error, UnreachableError) or (isinstance(error, ApiProblemError) and error.status == 401)
