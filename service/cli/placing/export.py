"""`panoloc export`: writes placed photos in the formats of other systems.

The photos come from a folder of `panoloc place`, a batch, or the answers of `panoloc localize`.
"""

import tempfile
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, get_args

import typer
from rich.markup import escape

from panoloc.core.options import FORMATS_ON_EARTH, ExportFormat
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.placing.place_folder import PlaceFolder
from panoloc.service.cli.placing.processes import ProcessFailedError, write_export
from panoloc.service.cli.placing.saved_answers import SavedAnswers
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from panoloc.service.client import ApiProblemError, ClientError, JsonObject, PanolocClient

FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
_REFUSED = 422


@dataclass(frozen=True)
class Written:
    """What exports wrote. paths: of folders and files. refusals: why others were not written."""

    paths: list[Path] = field(default_factory=list)
    refusals: list[str] = field(default_factory=list)


def export(
    ctx: typer.Context,
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="The --out folder of `panoloc place` or `panoloc localize`, one NAME.json in the latter, or the id "
            "of a batch.",
        ),
    ],
    formats: Annotated[
        str,
        typer.Option(
            "--export",
            metavar="FORMATS",
            help="Formats, separated by commas, such as potree,colmap; see docs/exports.md.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(file_okay=False, help="Folder that gets one subfolder per format; default: SOURCE.")
    ] = None,
    map_id: Annotated[
        str | None, typer.Option("--map", help="Only photos in this map, for a batch in several maps.")
    ] = None,
    include_ambiguous: Annotated[
        bool, typer.Option("--include-ambiguous", help="Also export ambiguous photos, at the most likely place.")
    ] = False,
    scan: Annotated[
        Path | None,
        typer.Option(
            exists=True, dir_okay=False, help="E57 file behind the map; the e57 export then keeps all points."
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Write placed photos in the formats of other systems, with a list of photos without a pose."""
    session: Session = ctx.obj
    session.json_output = json
    wanted = formats_of(formats)
    if not wanted:
        raise typer.BadParameter("expected at least one format, got none", param_hint="--export")
    folder = Path(source)
    with session.client(url) as client:
        if PlaceFolder.is_at(folder):
            placed = PlaceFolder.open(folder)
            stale = _refresh_maps(client, placed)
            written = write_exports(placed, wanted, include_ambiguous, out or folder, scan)
            if written.refusals and stale:
                written.refusals.append(stale)
        elif folder.exists():
            with tempfile.TemporaryDirectory(prefix="panoloc-") as maps:
                answers = SavedAnswers.fetch(folder, client, Path(maps))
                target = out or (folder if folder.is_dir() else folder.parent)
                written = write_exports(answers, wanted, include_ambiguous, target, scan)
        elif source.startswith("batch_"):
            query = {"map_id": map_id} if map_id else {}
            query |= {"include": "ambiguous"} if include_ambiguous else {}
            written = _fetch_exports(client, source, wanted, query, out or folder)
        else:
            raise typer.BadParameter(
                "expected a folder of `panoloc place` or `panoloc localize`, an answer, or the id of a batch, "
                f"got {source!r}",
                param_hint="SOURCE",
            )
    for path in written.paths:
        if json:
            session.print_json({"folder": str(path)})
        else:
            session.results.print(f"wrote {path}", markup=False)
    return show_refusals(session, written.refusals)


def show_refusals(session: Session, refusals: Iterable[str]) -> ExitCode:
    """Show why exports were not written; return the exit code."""
    code = ExitCode.OK
    for refusal in refusals:
        session.messages.print(f"[bold red]Error:[/] {escape(refusal)}")
        code = ExitCode.ERROR
    return code


def formats_of(given: str | None) -> list[ExportFormat]:
    """Return the formats in a comma-separated list, each once. Raises typer.BadParameter."""
    wanted = [name.strip() for name in (given or "").split(",") if name.strip()]
    unknown = [name for name in wanted if name not in FORMATS]
    if unknown:
        raise typer.BadParameter(
            f"expected formats among {', '.join(FORMATS)}, got {unknown[0]!r}", param_hint="--export"
        )
    return [name for name in FORMATS if name in wanted]


def check_on_earth(formats: list[ExportFormat], maps: Iterable[JsonObject]) -> None:
    """Raise typer.BadParameter where a format needs places on Earth and none of the maps has any.

    maps: as the service describes them; read only if a format depends on them.
    """
    on_earth = [name for name in formats if name in FORMATS_ON_EARTH]
    known = list(maps) if on_earth else []
    if known and not any(each.get("georeference") or each.get("coordinate_system") for each in known):
        raise typer.BadParameter(
            f"{', '.join(on_earth)}: expected a map with a georeference or a coordinate system, because the format "
            f"holds places on Earth, got a map with neither; set one with PATCH /maps/{id}, or leave the format out "
            "and write it later with `panoloc export`",
            param_hint="--export",
        )


def write_exports(
    placed: PlaceFolder | SavedAnswers,
    formats: list[ExportFormat],
    include_ambiguous: bool,
    out: Path,
    survey: Path | None = None,
) -> Written:
    """Write each format into a folder below `out`; with several maps, below a folder per map.

    A format that cannot hold the photos does not stop the others. survey: the scan itself, an E57 in the frame of the
    map. Raises typer.BadParameter.
    """
    written, maps = Written(), placed.maps()
    for map_id in maps:
        tour = placed.tour(map_id, include_ambiguous, survey)
        for name in formats:
            target = out / name if len(maps) == 1 else out / map_id / name
            try:
                write_export(tour, name, target)
                written.paths.append(target)
            except ProcessFailedError as error:
                written.refusals.append(str(error))
    return written


def _refresh_maps(client: PanolocClient, placed: PlaceFolder) -> str | None:
    """Update the stored maps, for example with a new georeference; return why that was not possible, else None."""
    if not client.is_live():
        return (
            f"no service answers at {client.url}, so the export uses the maps' data from the time of placing; start "
            "the service to get newer data"
        )
    try:
        for map_id in placed.maps():
            placed.put_map(client.get_map(map_id))
    except ClientError as error:
        return f"the export uses the maps' data from the time of placing, because {error}"
    return None


def _fetch_exports(
    client: PanolocClient, batch_id: str, formats: list[ExportFormat], query: dict[str, str], out: Path
) -> Written:
    written = Written()
    for name in formats:
        with tempfile.TemporaryFile(prefix="panoloc-") as file:
            try:
                client.download(f"/batches/{batch_id}/export", {"format": name, **query}, file)
            except ApiProblemError as problem:
                if problem.status != _REFUSED:
                    raise
                written.refusals.append(str(problem))
                continue
            with zipfile.ZipFile(file) as archive:
                archive.extractall(out / name)
        written.paths.append(out / name)
    return written
