"""`panoloc keys`: make, list and revoke the API keys in the data folder of a service."""

import getpass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.session import JsonOption, Session
from panoloc.service.keys.audit_log import AuditLog
from panoloc.service.keys.key_file import KeyFile, KeyFileError

app = typer.Typer(
    help="Make, list and revoke API keys in the data folder of a service. The service does not have to run.",
    no_args_is_help=True,
)


class ScopeName(StrEnum):
    """What a key may do; see `panoloc.service.keys.caller.Scope`."""

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
    name: Annotated[str, typer.Argument(help="Name of the key's owner, for display.")],
    scope: Annotated[list[ScopeName], typer.Option(help="What the key may do; repeatable.")],
    tenant: Annotated[
        str | None,
        typer.Option(help="Tenant of the key and its maps. Several keys can share a tenant; default: a new one."),
    ] = None,
    data_dir: DataDirOption = _DEFAULT_FOLDER,
    json: JsonOption = False,
) -> int:
    """Make a key and show it once: only its digest is stored. From then on the service requires a key from callers."""
    session = Session.of(ctx, json)
    # A key is a file in the data folder; what a service stores there is in folders.
    is_used = data_dir.is_dir() and any(each.is_dir() for each in data_dir.iterdir())
    made, text = KeyFile(data_dir).make(name, [each.value for each in scope], tenant)
    AuditLog(data_dir).note(_user(), "key made", made.id)
    document = {"id": made.id, "name": name, "tenant": made.tenant, "scopes": list(made.scopes), "key": text}
    session.show(document, text)
    if not json:
        session.messages.print(f"{made.id}: save this key now, it is not shown again.", markup=False)
        session.messages.print(f"stored in {data_dir.resolve()}", markup=False)
    if not is_used:
        session.messages.print(
            "No service has used that folder yet. The key works only for a service with this data folder: set the "
            "folder with --data-dir or PANOLOC_DATA_DIR.",
            markup=False,
        )
    elif ScopeName.admin not in scope and next(data_dir.glob("maps/map_*"), None):
        session.messages.print(
            "The key has access only to the maps of its tenant. Maps made without a key have no tenant: an admin key "
            "sees them, and `panoloc maps share ID --with TENANT` shares them.",
            markup=False,
        )
    return ExitCode.OK


@app.command("list")
def list_keys(ctx: typer.Context, data_dir: DataDirOption = _DEFAULT_FOLDER, json: JsonOption = False) -> int:
    """List all keys, revoked ones too, without their secrets."""
    session = Session.of(ctx, json)
    if not data_dir.exists():
        # The default folder depends on where the command runs, so show which one was read.
        raise typer.BadParameter(
            f"expected the data folder of a service, got {data_dir.resolve()}, which does not exist; set --data-dir or "
            "PANOLOC_DATA_DIR",
            param_hint="--data-dir",
        )
    keys = KeyFile(data_dir).read()
    table = Table("id", "name", "tenant", "scopes", "made", "revoked")
    for key in keys:
        row = (key.id, key.name, key.tenant, " ".join(key.scopes), key.created_at, key.revoked_at or "")
        table.add_row(*row)
        if json:
            names = ("id", "name", "tenant", "scopes", "created_at", "revoked_at")
            session.print_json(dict(zip(names, row, strict=True)))
    if not keys:
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
    """Revoke keys. Services refuse them within a second; maps made with them stay."""
    session: Session = ctx.obj
    failures: list[str] = []
    for key_id in dict.fromkeys(key_ids):  # one unknown id must not leave the keys after it valid
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


def _user() -> str:
    return f"user {getpass.getuser()}"
