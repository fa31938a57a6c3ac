"""`panoloc localize`: find where panoramas were taken."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from core.options import MAX_TOP_K, Frame, Method
from core.panorama.image_header import KNOWN_FORMATS
from service.cli.answer_files import AnswerFolder
from service.cli.exit_codes import ExitCode, exit_code_of, worst_of
from service.cli.progress import show_waiting
from service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from service.client import ApiProblemError, JsonObject, PanolocClient
from service.jobs import ARTIFACTS, QueryOptions

Point = tuple[float, float, float]
Cuboid = tuple[float, float, float, float, float, float]


def localize(
    ctx: typer.Context,
    panoramas: Annotated[
        list[Path],
        typer.Argument(exists=True, dir_okay=False, readable=True, help=f"Panoramas or photos ({KNOWN_FORMATS})."),
    ],
    map_id: Annotated[list[str] | None, typer.Option("--map", help="Map to search; repeatable.")] = None,
    tag: Annotated[str | None, typer.Option(help="Search all maps that bear this tag instead.")] = None,
    out: Annotated[
        Path | None, typer.Option(file_okay=False, help="Folder for the answers and score-map pictures.")
    ] = None,
    frame: Annotated[Frame, typer.Option(help="Axes in which the pose is given.")] = QueryOptions.frame,
    method: Annotated[Method, typer.Option(help="The default, or the paper's own recipe.")] = QueryOptions.method,
    mask: Annotated[
        Path | None, typer.Option(exists=True, dir_okay=False, help="Image; its non-zero pixels are ignored.")
    ] = None,
    hfov: Annotated[
        float | None, typer.Option(help="A photo so many degrees wide; phones say it in EXIF.", metavar="DEG")
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="JSON file: an entry of `cameras` as in docs/api.md."),
    ] = None,
    position: Annotated[Point | None, typer.Option(metavar="X Y Z", help="Hint: near this place, metres.")] = None,
    radius: Annotated[float | None, typer.Option(help="Hint: at most this far from --position, metres.")] = None,
    region: Annotated[
        Cuboid | None, typer.Option(metavar="X Y Z X Y Z", help="Hint: within this cuboid (least, greatest corner).")
    ] = None,
    upright: Annotated[bool, typer.Option("--upright", help="Hint: the camera was level.")] = False,
    max_tilt: Annotated[float | None, typer.Option(help="Hint: tilted by at most this, degrees.")] = None,
    heading: Annotated[float | None, typer.Option(help="Hint: yaw of the image centre, degrees.")] = None,
    heading_tolerance: Annotated[
        float | None, typer.Option(help="Hint: --heading is right within this, degrees.")
    ] = None,
    top_k: Annotated[
        int, typer.Option(min=1, max=MAX_TOP_K, help="Poses to return, alternatives included.")
    ] = QueryOptions.top_k,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            help="Seconds until the service gives up; when left out, as many as it allows by itself: more for paper.",
        ),
    ] = None,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Find where panoramas were taken in a map. Exit code 0: all localized, 3: some not, 4: some ambiguous."""
    if bool(map_id) == bool(tag):
        raise typer.BadParameter(
            f"expected --map ID (repeatable) or --tag TAG, got {'both' if tag else 'neither'}; `panoloc maps` lists them.",
            param_hint="--map",
        )
    hints = _hints_object(position, radius, region, upright, max_tilt, heading, heading_tolerance)
    options: JsonObject = {"frame": frame, "method": method, "top_k": top_k}
    options["artifacts"] = list(ARTIFACTS) if out else []
    described = _camera_object(hfov, camera)
    options |= {"cameras": [described]} if described else {}
    options |= {"hints": hints} if hints else {}
    options |= {"timeout_s": timeout} if timeout else {}
    session: Session = ctx.obj
    session.json_output = json
    with session.client(url) as client:
        command = _Localize(
            session, client, tuple(map_id or ()), tag, mask, options, AnswerFolder(out) if out else None
        )
        return worst_of([command.run(panorama, several=len(panoramas) > 1) for panorama in panoramas])


@dataclass(frozen=True)
class _Localize:
    """What all panoramas of one command have in common."""

    session: Session
    client: PanolocClient
    map_ids: Sequence[str]
    tag: str | None
    mask: Path | None
    options: JsonObject
    folder: AnswerFolder | None

    def run(self, panorama: Path, *, several: bool) -> ExitCode:
        """Localize and show one panorama; among several, a refused one does not stop the others."""
        try:
            with show_waiting(self.session.messages, f"localizing {escape(panorama.name)}"):
                answer = self.client.localize(panorama, self.map_ids, self.tag, self.mask, self.options)
        except ApiProblemError as problem:
            if not several:
                raise
            self._show_problem(panorama, problem)
            return ExitCode.ERROR
        saved = self.folder.save(panorama, answer, self.client) if self.folder else []
        self._show(panorama, answer, saved)
        return exit_code_of(answer["status"])

    def _show(self, panorama: Path, answer: JsonObject, saved: list[Path]) -> None:
        if self.session.json_output:
            self.session.print_json({"panorama": str(panorama), **answer})
            return
        self.session.results.print(f"[bold]{escape(str(panorama))}[/]")
        self.session.show_answer(answer, self.client)
        if saved:
            self.session.messages.print(f"saved {', '.join(escape(str(path)) for path in saved)}")

    def _show_problem(self, panorama: Path, problem: ApiProblemError) -> None:
        if self.session.json_output:
            self.session.print_json({"panorama": str(panorama), "error": problem.as_dict()})
        self.session.messages.print(
            f"[bold]{escape(str(panorama))}[/]  [bold red]{escape(problem.title)}[/] (HTTP {problem.status})"
        )
        self.session.messages.print(escape(str(problem)))


def _camera_object(hfov_deg: float | None, file: Path | None) -> JsonObject | None:
    """Return the camera as the HTTP API takes it, None where nothing is said of it. Raises typer.BadParameter for a file that is none."""
    if file is None:
        return None if hfov_deg is None else {"model": "pinhole", "hfov_deg": hfov_deg}
    if hfov_deg is not None:
        raise typer.BadParameter(
            "expected --hfov or --camera, got both; the file can hold hfov_deg", param_hint="--hfov"
        )
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"expected a JSON file, but {file}: {error}", param_hint="--camera") from error
    if not isinstance(found, dict):
        raise typer.BadParameter(
            f'expected an object such as {{"model": "pinhole", "hfov_deg": 69}} in {file}, got {type(found).__name__}',
            param_hint="--camera",
        )
    return found


def _hints_object(
    position: tuple[float, float, float] | None,
    radius: float | None,
    region: tuple[float, float, float, float, float, float] | None,
    upright: bool,
    max_tilt: float | None,
    heading: float | None,
    heading_tolerance: float | None,
) -> JsonObject:
    """Return the hints that were given as the HTTP API takes them; metres and degrees.

    Raises typer.BadParameter for a hint that means nothing without another.
    """
    if radius is not None and position is None:
        raise typer.BadParameter("--radius needs --position X Y Z", param_hint="--radius")
    if heading_tolerance is not None and heading is None:
        raise typer.BadParameter("--heading-tolerance needs --heading", param_hint="--heading-tolerance")
    given: JsonObject = {
        "position_m": list(position) if position else None,
        "radius_m": radius,
        "region": {"min": list(region[:3]), "max": list(region[3:])} if region else None,
        "upright": upright or None,
        "max_tilt_deg": max_tilt,
        "heading_deg": heading,
        "heading_tolerance_deg": heading_tolerance,
    }
    return {name: value for name, value in given.items() if value is not None}
