"""`panoloc localize`: find where panoramas, photos and sessions were taken."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from panoloc.core.image.image_header import KNOWN_FORMATS
from panoloc.core.options import MAX_IMAGES, MAX_TOP_K, Frame
from panoloc.core.scan.file_names import distinct_names
from panoloc.service.cli.exit_codes import exit_code_of, worst_of
from panoloc.service.cli.progress import show_waiting
from panoloc.service.cli.query_options import (
    HfovOption,
    MapOption,
    MethodOption,
    TagOption,
    UprightOption,
    camera_object,
    check_map_choice,
    hints_object,
)
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption, make_out_folder
from panoloc.service.cli.transforms import FILE_NAME, TransformsError, read_transforms, spread_evenly
from panoloc.service.client import ApiProblemError, JsonClient, JsonObject
from panoloc.service.jobs import ARTIFACTS, QueryOptions

_IS_PANORAMA = "taken for a panorama, without --hfov; describe another camera with --camera"

Point = tuple[float, float, float]
Cuboid = tuple[float, float, float, float, float, float]


def localize(
    ctx: typer.Context,
    panoramas: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="IMAGE",
            exists=True,
            dir_okay=False,
            readable=True,
            help=f"Panoramas or photos ({KNOWN_FORMATS}), each a query of its own.",
        ),
    ] = None,
    tracked: Annotated[
        Path | None,
        typer.Option(
            "--session",
            exists=True,
            metavar="PATH",
            help=f"{FILE_NAME} or its folder: one query of all its frames, with their poses.",
        ),
    ] = None,
    up_known: Annotated[
        bool, typer.Option("--up-known", help="The z axis of --session points up, as AR devices define it.")
    ] = False,
    map_id: MapOption = None,
    tag: TagOption = None,
    out: Annotated[
        Path | None, typer.Option(file_okay=False, help="Folder for the answers and their pictures.")
    ] = None,
    frame: Annotated[Frame, typer.Option(help="Axes of the pose.")] = QueryOptions.frame,
    method: MethodOption = QueryOptions.method,
    mask: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Mask image: its non-zero pixels are ignored.")
    ] = None,
    hfov: HfovOption = None,
    camera: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="JSON file with an entry of `cameras` as in docs/api.md."),
    ] = None,
    position: Annotated[Point | None, typer.Option(metavar="X Y Z", help="Hint: camera position, metres.")] = None,
    radius: Annotated[float | None, typer.Option(help="Hint: largest distance from --position, metres.")] = None,
    region: Annotated[
        Cuboid | None,
        typer.Option(metavar="X Y Z X Y Z", help="Hint: cuboid around the camera (lowest, highest corner)."),
    ] = None,
    upright: UprightOption = False,
    max_tilt: Annotated[float | None, typer.Option(help="Hint: largest tilt of the camera, degrees.")] = None,
    heading: Annotated[float | None, typer.Option(help="Hint: yaw of the image centre, degrees.")] = None,
    heading_tolerance: Annotated[float | None, typer.Option(help="Hint: tolerance of --heading, degrees.")] = None,
    top_k: Annotated[
        int, typer.Option(min=1, max=MAX_TOP_K, help="Number of poses, including alternatives.")
    ] = QueryOptions.top_k,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Timeout in seconds; default: the service's limit, which is longer for paper.",
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Find where panoramas, photos or the frames of a session were taken. Exit code 3: some not localized, 4: some ambiguous."""
    if not panoramas and not tracked:
        raise typer.BadParameter("expected at least one image, or --session PATH, got neither", param_hint="IMAGE")
    check_map_choice(map_id, tag, may_be_all=True)
    session = Session.of(ctx, json)
    described = camera_object(hfov, camera)
    if bool(panoramas) == bool(tracked) or (tracked and described) or (up_known and not tracked):
        raise typer.BadParameter(
            "expected either images, or --session PATH, whose file describes the cameras in place of --hfov and --camera. "
            "--up-known needs --session",
            param_hint="--session",
        )
    hints = hints_object(position, radius, region, upright, max_tilt, heading, heading_tolerance)
    options: JsonObject = {"frame": frame, "method": method, "top_k": top_k}
    options["artifacts"] = list(ARTIFACTS) if out else []
    options |= {"cameras": [described]} if described else {}
    options |= {"hints": hints} if hints else {}
    options |= {"timeout_s": timeout} if timeout else {}
    queries = [_Query(path, [path]) for path in panoramas or ()]
    queries += [_session_query(session, tracked, frame, up_known)] if tracked else []
    if out is not None:
        make_out_folder(out)
    codes = []
    with session.client(url) as client:
        # Two folders may hold the same file name.
        for stem, query in zip(distinct_names(query.name.stem for query in queries), queries, strict=True):
            try:
                with show_waiting(session.messages, f"localizing {escape(query.name.name)}"):
                    answer = client.localize(query.images, map_id or (), tag, mask, options | query.options)
            except ApiProblemError as problem:
                if len(queries) == 1:
                    raise
                codes.append(session.show_failure(problem, [str(query.name)], key="panorama"))
                continue
            if hfov is not None and answer["images"] and answer["images"][0]["camera"]["model"] == "equirectangular":
                session.messages.print(f"{query.name.name}: {_IS_PANORAMA}", markup=False)
            saved = [] if out is None else save_answer(out, stem, query.images, answer, client)
            _show(session, client, query, answer, saved)
            codes.append(exit_code_of(answer["status"]))
    return worst_of(codes)


@dataclass(frozen=True)
class _Query:
    """One query. name: of its answer. options: those that only this query has."""

    name: Path
    images: Sequence[Path]
    options: JsonObject = field(default_factory=dict)


def _session_query(session: Session, tracked: Path, frame: Frame, up_known: bool) -> _Query:
    """Return one query of all frames of a file. Raises typer.BadParameter for a file that cannot be read."""
    try:
        found = read_transforms(tracked, frame)
    except TransformsError as error:
        raise typer.BadParameter(str(error), param_hint="--session") from error
    chosen = spread_evenly(found, MAX_IMAGES)
    if len(chosen) < len(found):
        session.messages.print(
            f"{len(chosen)} of {len(found)} frames are sent, evenly spread, because a query is limited to that number"
        )
    options: JsonObject = {"cameras": [each.camera for each in chosen]}
    options |= {"session": {"up": "known"}} if up_known else {}
    folder = tracked if tracked.is_dir() else tracked.parent
    return _Query(folder.resolve(), [each.path for each in chosen], options)


def save_answer(folder: Path, stem: str, images: Sequence[Path], answer: JsonObject, client: JsonClient) -> list[Path]:
    """Write `STEM.json` and up to three pictures into a folder, and return these files.

    images: what was sent; the answer lists them as `files`, for exports. The answer to other images of that name stays: then it is
    `STEM-2.json`.
    """
    document = {"files": [str(image.resolve()) for image in images], **answer}
    names = chain([stem], (f"{stem}-{number}" for number in count(2)))
    stem = next(name for name in names if _files_of(folder / f"{name}.json") in (None, document["files"]))
    written = [folder / f"{stem}.json"]
    text = json.dumps(document, indent=2, ensure_ascii=False) + "\n"
    written[0].write_bytes(text.encode(errors="backslashreplace"))  # file names that are not UTF-8
    for kind, path in answer["artifacts"].items():
        written.append(folder / f"{stem}.{kind.replace('_', '-')}.png")
        written[-1].write_bytes(client.fetch(path))
    return written


def _files_of(answer: Path) -> object:
    """Return of which images there is an answer in a file; None where there is none."""
    try:
        return json.loads(answer.read_bytes()).get("files")
    except (FileNotFoundError, ValueError, AttributeError):
        return None


def _show(session: Session, client: JsonClient, query: _Query, answer: JsonObject, saved: Sequence[Path]) -> None:
    files = [str(path) for path in query.images]
    if session.json_output:
        about = {"session": str(query.name), "files": files} if query.options else {"panorama": files[0]}
        session.print_json({**about, **answer})
        return
    session.results.print(f"[bold]{escape(str(query.name))}[/]")
    session.show_answer(answer, client, [path.name for path in query.images])
    if saved:
        session.messages.print(f"saved {', '.join(escape(str(path)) for path in saved)}")
