"""`panoloc export`: writes placed photos in the formats of other systems.

The photos come from a folder of `panoloc place`, a batch, or the answers of `panoloc localize`.
"""

import json
import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, get_args
from urllib.parse import urlencode

import typer
from rich.markup import escape

from panoloc.core.options import FORMATS_ON_EARTH, ExportFormat
from panoloc.core.scan.file_names import distinct_names
from panoloc.service.batches.tour import Photo, lacks_place
from panoloc.service.cli.exit_codes import ExitCode
from panoloc.service.cli.placing.place_folder import PlaceFolder
from panoloc.service.cli.placing.placed_photos import PlacedPhotos, Written, how_to_place, what_was_written
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption, make_out_folder
from panoloc.service.client import ApiProblemError, ClientError, JsonClient, JsonObject
from panoloc.service.jobs import Result

FORMATS: tuple[ExportFormat, ...] = get_args(ExportFormat)
IMAGES_AT_A_TIME = 200
"""Files that are open at the same time, and images on a page."""

_REFUSED, _NOT_FOUND = 422, 404
_E57_HEAD = b"ASTM-E57"


FormatsOption = Annotated[
    str | None,
    typer.Option(
        "--export",
        metavar="FORMATS",
        help="Formats, separated by commas, such as potree,colmap; see docs/exports.md.",
    ),
]
IncludeAmbiguousOption = Annotated[
    bool, typer.Option("--include-ambiguous", help="Also export ambiguous photos, at the most likely place.")
]


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
    formats: FormatsOption,
    out: Annotated[
        Path | None, typer.Option(file_okay=False, help="Folder that gets one subfolder per format; default: SOURCE.")
    ] = None,
    map_id: Annotated[
        str | None, typer.Option("--map", help="Only photos in this map, of photos in several maps.")
    ] = None,
    include_ambiguous: IncludeAmbiguousOption = False,
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
    session = Session.of(ctx, json)
    wanted = formats_of(formats)
    if not wanted:
        raise typer.BadParameter("expected at least one format, got none", param_hint="--export")
    if scan is not None and not is_e57(scan):
        raise typer.BadParameter(f"expected an E57 file, got {scan}, which is none", param_hint="--scan")
    folder = Path(source)
    if out is not None:
        make_out_folder(out)
    with session.client(url) as client, tempfile.TemporaryDirectory(prefix="panoloc-") as maps_folder:
        if (placed_folder := PlaceFolder.open(folder)) is not None:
            stale = _refresh(client, placed_folder)
            placed = placed_folder.placed()
            written = placed.write_exports(wanted, include_ambiguous, out or folder, scan, map_id)
            if written.refusals and stale:
                session.messages.print(f"Note: {stale}", markup=False)
        elif folder.exists():
            placed = _read_answers(folder, Path(maps_folder))
            placed.fetch_maps(client)
            target = out or (folder if folder.is_dir() else folder.parent)
            written = placed.write_exports(wanted, include_ambiguous, target, scan, map_id)
        elif source.startswith("batch_"):
            query = {"map_id": map_id} if map_id else {}
            query |= {"include": "ambiguous"} if include_ambiguous else {}
            written = _fetch_exports(client, source, wanted, query, out or folder)
        else:
            raise _wrong_source(
                "expected a folder of `panoloc place` or `panoloc localize`, an answer, or the id of a batch, "
                f"got {source!r}"
            )
    for path in written.paths:
        session.show({"folder": str(path)}, f"wrote {what_was_written(path)}")
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
    if known and all(lacks_place(on_earth[0], each) for each in known):
        raise typer.BadParameter(
            f"{', '.join(on_earth)}: expected a map with a georeference or a coordinate system, because the format "
            f"holds places on Earth, got a map with neither; set one with {how_to_place('MAP')}, "
            "or leave the format out and write it later with `panoloc export`",
            param_hint="--export",
        )


def take_hand_placements(client: JsonClient, folder: PlaceFolder) -> None:
    """Store the answers of photos that a person has placed since, or no longer places, in place of theirs. Raises ClientError."""
    for batch_id, photos in folder.kept().items():
        for item in _items(client, batch_id):
            photo, answer = photos.get(item["name"]), item["answer"]
            if photo is None or photo.result is None or answer is None:
                continue
            former = photo.result["answer"]
            if answer != former and "hand" in (answer["placed_by"], former.get("placed_by")):
                folder.put_result(photo, {"status": item["status"], "answer": answer})


def _read_answers(source: Path, maps_folder: Path) -> PlacedPhotos:
    """Return the images of an answer, or of all in a folder, as `panoloc localize --out` saves them.

    Raises typer.BadParameter.
    """
    files = sorted(source.glob("*.json")) if source.is_dir() else [source]
    found = [(file, answer) for file in files if (answer := _read_answer(file)) is not None]
    images = [each for file, answer in found for each in _images_of(file, answer)]
    if not images:
        raise _wrong_source(
            "expected the --out of `panoloc place` or `panoloc localize`, or an answer in the latter, "
            f"but {source} is none of these"
        )
    names = distinct_names(image.name for image, _ in images)
    photos = [Photo(name, *each) for name, each in zip(names, images, strict=True)]
    return PlacedPhotos(photos, max(file.stat().st_mtime for file, _ in found), maps_folder)


def _read_answer(file: Path) -> JsonObject | None:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "files" in found and "status" in found else None


def _images_of(at: Path, answer: JsonObject) -> Iterator[tuple[Path, Result]]:
    """Yield the images of an answer, each as if it were a query of its own. Raises typer.BadParameter if one is gone."""
    for file, image in zip(map(Path, answer["files"]), answer["images"], strict=True):
        if not file.is_file():
            raise _wrong_source(f"expected the photo {file} of {at}, but it is no longer there; put it back")
        yield file, {"status": answer["status"], "answer": {**answer, "pose": image["pose"], "images": [image]}}


def _refresh(client: JsonClient, folder: PlaceFolder) -> str | None:
    """Store what has changed since: photos placed by hand, and maps, for example with a new georeference.

    Returns why that was not possible, else None.
    """
    if not client.is_live():
        return (
            f"no service answers at {client.url}, so the export uses what is stored from the time of placing; start "
            "the service to get newer data"
        )
    try:
        take_hand_placements(client, folder)
        folder.placed().fetch_maps(client, with_points=False)
    except ClientError as error:
        return f"the export uses what is stored from the time of placing; newer data could not be read: {error}"
    return None


def _items(client: JsonClient, batch_id: str) -> Iterator[JsonObject]:
    """Yield the images of a batch; none of one that was deleted."""
    cursor: str | None = ""
    while cursor is not None:
        query = urlencode({"limit": IMAGES_AT_A_TIME} | ({"cursor": cursor} if cursor else {}))
        try:
            page = client.fetch_json(f"/batches/{batch_id}?{query}")
        except ApiProblemError as problem:
            if problem.status == _NOT_FOUND:
                return
            raise
        yield from page["items"]
        cursor = page["next_cursor"]


def _fetch_exports(
    client: JsonClient, batch_id: str, formats: list[ExportFormat], query: dict[str, str], out: Path
) -> Written:
    written = Written()
    for name in formats:
        with tempfile.TemporaryFile(prefix="panoloc-") as file:
            try:
                client.download(f"/batches/{batch_id}/export", {"format": name, **query}, file)
            except ApiProblemError as problem:
                if problem.status != _REFUSED:
                    raise
                written.refusals.append(re.sub(r"PATCH /maps/(\w+)", lambda map_: how_to_place(map_[1]), str(problem)))
                continue
            with zipfile.ZipFile(file) as archive:
                archive.extractall(out / name)
        written.paths.append(out / name)
    return written


def is_e57(file: Path) -> bool:
    """Tell whether a file begins as an E57 does. Raises OSError."""
    with file.open("rb") as stream:
        return stream.read(len(_E57_HEAD)) == _E57_HEAD


def _wrong_source(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="SOURCE")
