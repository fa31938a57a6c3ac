"""`panoloc localize`: find where panoramas, photos and sessions were taken."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from panoloc.core.options import MAX_IMAGES, MAX_TOP_K, Frame
from panoloc.core.panorama.image_header import KNOWN_FORMATS
from panoloc.service.cli.answer_files import AnswerFolder
from panoloc.service.cli.exit_codes import ExitCode, exit_code_of, worst_of
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
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from panoloc.service.cli.transforms import FILE_NAME, TransformsError, read_transforms, spread_evenly
from panoloc.service.client import ApiProblemError, JsonObject, PanolocClient
from panoloc.service.jobs import ARTIFACTS, QueryOptions

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
    check_map_choice(map_id, tag)
    session: Session = ctx.obj
    session.json_output = json
    described = camera_object(hfov, camera)
    if bool(panoramas) == bool(tracked) or (tracked and described) or (up_known and not tracked):
        raise typer.BadParameter(
            "expected either images, or --session PATH, whose file describes the cameras. --up-known needs --session",
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
    with session.client(url) as client:
        command = _Localize(
            session, client, tuple(map_id or ()), tag, mask, options, AnswerFolder(out) if out else None
        )
        return worst_of([command.run(query, several=len(queries) > 1) for query in queries])


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


@dataclass(frozen=True)
class _Localize:
    """What all queries of one command share."""

    session: Session
    client: PanolocClient
    map_ids: Sequence[str]
    tag: str | None
    mask: Path | None
    options: JsonObject
    folder: AnswerFolder | None

    def run(self, query: _Query, *, several: bool) -> ExitCode:
        """Localize and show one query; if there are `several`, a refused one does not stop the others."""
        try:
            with show_waiting(self.session.messages, f"localizing {escape(query.name.name)}"):
                answer = self.client.localize(
                    query.images, self.map_ids, self.tag, self.mask, self.options | query.options
                )
        except ApiProblemError as problem:
            if not several:
                raise
            return self.session.show_failure(problem, [str(query.name)], key="panorama")
        saved = self.folder.save(query.name, query.images, answer, self.client) if self.folder else []
        self._show(query, answer, saved)
        return exit_code_of(answer["status"])

    def _show(self, query: _Query, answer: JsonObject, saved: list[Path]) -> None:
        files = [str(path) for path in query.images]
        if self.session.json_output:
            about = {"session": str(query.name), "files": files} if query.options else {"panorama": files[0]}
            self.session.print_json({**about, **answer})
            return
        self.session.results.print(f"[bold]{escape(str(query.name))}[/]")
        self.session.show_answer(answer, self.client, [path.name for path in query.images])
        if saved:
            self.session.messages.print(f"saved {', '.join(escape(str(path)) for path in saved)}")
