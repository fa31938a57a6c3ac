"""`panoloc export`: placed photos in the formats of other systems, of a folder of `panoloc place`, a batch, or single answers."""

import tempfile
import zipfile
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from core.options import ExportFormat
from service.cli.exit_codes import ExitCode
from service.cli.placing.export_folder import Written, formats_of, write_exports
from service.cli.placing.place_folder import PlaceFolder, PlaceFolderError
from service.cli.placing.saved_answers import SavedAnswers
from service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from service.client import ApiProblemError, ClientError, PanolocClient

_REFUSED = 422


def export(
    ctx: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="The --out of `panoloc place` or of `panoloc localize`, one answer in the latter, or the id of a batch.",
        ),
    ],
    formats: Annotated[
        str,
        typer.Option(
            "--export", metavar="FORMATS", help="Formats with commas, such as potree,colmap; see docs/exports.md."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(file_okay=False, help="Folder, with one below it per format; SOURCE when left out.")
    ] = None,
    map_id: Annotated[str | None, typer.Option("--map", help="Of a batch in several maps: photos in this one.")] = None,
    include_ambiguous: Annotated[
        bool, typer.Option("--include-ambiguous", help="Photos that fit several places, too, at the likeliest.")
    ] = False,
    scan: Annotated[
        Path | None,
        typer.Option(
            exists=True, dir_okay=False, help="The E57 that the map was made of: e57 holds it as it is, not thinned."
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Write placed photos in the formats of other systems, with a list of those that have no pose."""
    session: Session = ctx.obj
    session.json_output = json
    wanted = formats_of(formats)
    if not wanted:
        raise typer.BadParameter("expected at least one format, got none", param_hint="--export")
    folder = Path(source)
    try:
        if PlaceFolder.is_at(folder):
            placed = PlaceFolder.open(folder)
            with session.client(url) as client:
                refreshed = _refresh_maps(client, placed)
            written = write_exports(placed, wanted, include_ambiguous, out or folder, scan)
            if written.refusals and refreshed:
                written.refusals.append(refreshed)
        elif folder.exists():
            with session.client(url) as client, tempfile.TemporaryDirectory(prefix="panoloc-") as maps:
                answers = SavedAnswers.fetch(folder, client, Path(maps))
                target = out or (folder if folder.is_dir() else folder.parent)
                written = write_exports(answers, wanted, include_ambiguous, target, scan)
        elif source.startswith("batch_"):
            with session.client(url) as client:
                written = Written()
                for name in wanted:
                    try:
                        written.folders.append(
                            _fetch(client, source, name, (out or folder) / name, map_id, include_ambiguous)
                        )
                    except ApiProblemError as problem:
                        if problem.status != _REFUSED:
                            raise
                        written.refusals.append(str(problem))
        else:
            raise PlaceFolderError(
                f"expected a folder of `panoloc place` or `panoloc localize`, an answer, or the id of a batch, got {source!r}"
            )
    except PlaceFolderError as error:
        raise typer.BadParameter(str(error), param_hint="SOURCE") from error
    for target in written.folders:
        if json:
            session.print_json({"folder": str(target)})
        else:
            session.results.print(f"wrote {target}", markup=False)
    for refusal in written.refusals:
        session.messages.print(f"[bold red]Error:[/] {escape(refusal)}")
    return ExitCode.ERROR if written.refusals else ExitCode.OK


def _refresh_maps(client: PanolocClient, placed: PlaceFolder) -> str | None:
    """Fetch what the service knows of the maps now, such as a georeference that came later; return what to say where it cannot be had."""
    if not client.is_live():
        return f"no service answers at {client.url}, so maps are taken as they were when the photos were placed; start it for newer ones"
    try:
        for map_id in placed.maps():
            placed.put_map(client.get_map(map_id))
    except ClientError as error:
        return f"maps are taken as they were when the photos were placed, because {error}"
    return None


def _fetch(
    client: PanolocClient, batch_id: str, name: ExportFormat, target: Path, map_id: str | None, include_ambiguous: bool
) -> Path:
    query = {"format": name} | ({"map_id": map_id} if map_id else {})
    query |= {"include": "ambiguous"} if include_ambiguous else {}
    with tempfile.TemporaryFile(prefix="panoloc-") as file:
        client.download(f"/batches/{batch_id}/export", query, file)
        with zipfile.ZipFile(file) as archive:
            archive.extractall(target)
    return target
