"""`panoloc keys`: make, list and revoke the keys of a service, in its data folder."""

import getpass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from service.cli.exit_codes import ExitCode
from service.cli.session import JsonOption, Session
from service.keys.audit_log import AuditLog
from service.keys.key_file import KeyFile, KeyFileError

app = typer.Typer(
    help="Make, list and revoke API keys, in the data folder of a service; it need not run.", no_args_is_help=True
)


class ScopeName(StrEnum):
    """What a key may do; see `service.keys.caller.Scope`."""

    read = "read"
    localize = "localize"
    write = "write"
    admin = "admin"


DataDirOption = Annotated[
    Path, typer.Option(envvar="PANOLOC_DATA_DIR", file_okay=False, help="Data folder of the service.")
]
_DEFAULT_FOLDER = Path("panoloc-data")


@app.command()
def make(
    ctx: typer.Context,
    name: Annotated[str, typer.Argument(help="For people: whose key it is.")],
    scope: Annotated[list[ScopeName], typer.Option(help="What it may do; repeat the option.")],
    tenant: Annotated[
        str | None,
        typer.Option(help="Whose maps it sees and makes; left out: of this key alone. Several keys may share one."),
    ] = None,
    data_dir: DataDirOption = _DEFAULT_FOLDER,
    json: JsonOption = False,
) -> int:
    """Make a key and show it, once: only its digest is kept. From the first key on, the service asks all callers for one."""
    session: Session = ctx.obj
    # Keys are files; what a service keeps is in folders.
    is_used = data_dir.is_dir() and any(each.is_dir() for each in data_dir.iterdir())
    try:
        made, text = KeyFile(data_dir).make(name, [each.value for each in scope], tenant)
    except KeyFileError as error:
        return _refused(session, error)
    AuditLog(data_dir).note(_user(), "key made", made.id)
    if json:
        session.print_json(
            {"id": made.id, "name": name, "tenant": made.tenant, "scopes": list(made.scopes), "key": text}
        )
    else:
        session.results.print(text, markup=False, highlight=False)
        session.messages.print(f"{made.id}: keep it now, it is not shown again.", markup=False)
        session.messages.print(f"kept in {data_dir.resolve()}", markup=False)
    if not is_used:
        session.messages.print(
            "No service has used that folder yet: until one does, the key opens nothing and no service asks for it; "
            "name the data folder of yours with --data-dir or PANOLOC_DATA_DIR.",
            markup=False,
        )
    elif ScopeName.admin not in scope and next(data_dir.glob("maps/map_*"), None):
        session.messages.print(
            "It sees the maps of its tenant alone. Those that were made without a key belong to nobody: an admin key shows them, and "
            "`panoloc maps share ID --with TENANT` shares them.",
            markup=False,
        )
    return ExitCode.OK


@app.command("list")
def list_keys(ctx: typer.Context, data_dir: DataDirOption = _DEFAULT_FOLDER, json: JsonOption = False) -> int:
    """List all keys that were ever made; their texts are not kept."""
    session: Session = ctx.obj
    try:
        keys = KeyFile(data_dir).read()
    except KeyFileError as error:
        return _refused(session, error)
    table = Table("id", "name", "tenant", "scopes", "made", "revoked")
    for key in keys:
        shown = (key.id, key.name, key.tenant, " ".join(key.scopes), key.created_at, key.revoked_at or "")
        if json:
            session.print_json(
                dict(zip(("id", "name", "tenant", "scopes", "created_at", "revoked_at"), shown, strict=True))
            )
        table.add_row(*shown)
    if not keys:
        # The folder is relative to where the command runs, and another one may be meant.
        session.messages.print(f"No keys in {data_dir.resolve()}.", markup=False)
    elif not json:
        session.results.print(table)
    return ExitCode.OK


@app.command()
def revoke(
    ctx: typer.Context,
    key_ids: Annotated[list[str], typer.Argument(metavar="ID", help="Ids of the keys.")],
    data_dir: DataDirOption = _DEFAULT_FOLDER,
) -> int:
    """Let keys open nothing any more, within a second; what they made stays."""
    session: Session = ctx.obj
    failures: list[str] = []
    # Whoever revokes keys wants them shut: an id that is none must not leave those after it open.
    for key_id in dict.fromkeys(key_ids):
        try:
            KeyFile(data_dir).revoke(key_id)
        except (KeyFileError, OSError) as error:
            failures.append(f"Error: {key_id} is not revoked: {error}")
            continue
        AuditLog(data_dir).note(_user(), "key revoked", key_id)
        session.results.print(f"revoked {key_id}", markup=False)
    for failure in failures:
        session.messages.print(failure, markup=False)
    return ExitCode.ERROR if failures else ExitCode.OK


def _refused(session: Session, error: KeyFileError) -> int:
    session.messages.print(f"Error: {error}", markup=False)
    return ExitCode.ERROR


def _user() -> str:
    return f"user {getpass.getuser()}"
