"""`panoloc place`: a folder of photos, placed one by one, and written in the formats of other systems."""

import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from core.options import Method
from service.batches.archive import IMAGE_ENDINGS
from service.batches.record import Result
from service.cli.exit_codes import ExitCode, exit_code_of, worst_of
from service.cli.placing.export_folder import formats_of, why_not_on_earth, write_exports
from service.cli.placing.overview_files import draw_overviews
from service.cli.placing.place_folder import PlaceFolder, PlaceFolderError, Question, are_options_refused
from service.cli.placing.survey_images import SurveyError, folder_of_photos
from service.cli.progress import show_counts
from service.cli.query_options import camera_object, photo_options
from service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from service.client import ApiProblemError, JsonObject, PanolocClient
from service.jobs import MAX_SAMPLE_POINTS, QueryOptions

# What says nothing of the photo: the key, the map.
_NOT_OF_THE_PHOTO = (401, 403, 404, 409)
_ONLY_TIME = (429, 503)
_PATIENCE_S = 600.0


def place(
    ctx: typer.Context,
    photos: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", exists=True, help="Folder of photos, with folders in it; or an E57 with images in it."
        ),
    ],
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder for results and exports; run again, it goes on there.")
    ],
    map_id: Annotated[list[str] | None, typer.Option("--map", help="Map to search; repeatable.")] = None,
    tag: Annotated[str | None, typer.Option(help="Search all maps that bear this tag instead.")] = None,
    export: Annotated[
        str | None,
        typer.Option(metavar="FORMATS", help="Formats with commas, such as potree,colmap; see docs/exports.md."),
    ] = None,
    include_ambiguous: Annotated[
        bool, typer.Option("--include-ambiguous", help="Export photos that fit several places, too, at the likeliest.")
    ] = False,
    upright: Annotated[bool, typer.Option("--upright", help="Hint: the camera was level.")] = False,
    hfov: Annotated[
        str | None,
        typer.Option(help="Photos so many degrees wide; 2:1 panoramas among them stay what they are.", metavar="DEG"),
    ] = None,
    method: Annotated[Method, typer.Option(help="The default, or the paper's own recipe.")] = QueryOptions.method,
    parallel: Annotated[int, typer.Option(min=1, max=32, help="Photos sent at the same time.")] = 2,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Place all photos of a folder in a map. Run again after an end of any kind, it goes on: what is done stays done."""
    if bool(map_id) == bool(tag):
        raise typer.BadParameter("expected --map ID (repeatable) or --tag TAG, not both", param_hint="--map")
    session: Session = ctx.obj
    session.json_output = json
    formats = formats_of(export)
    camera = camera_object(hfov, None)
    options: JsonObject = {"method": method}
    options |= {"hints": {"upright": True}} if upright else {}
    options |= {"cameras": [camera]} if camera else {}
    try:
        folder = folder_of_photos(photos, out)
        question = Question(str(folder.resolve()), list(map_id or ()), tag, options)
        with session.client(url) as client:
            refused = why_not_on_earth(formats, _maps_of(client, question))
            if refused is not None:
                raise typer.BadParameter(refused, param_hint="--export")
        with PlaceFolder.held(out, question) as placed:
            with session.client(url) as client:
                codes = _Placing(session, client, placed).run(parallel)
            written = draw_overviews(placed)
            written.add(write_exports(placed, formats, include_ambiguous, out))
    except PlaceFolderError as error:
        raise typer.BadParameter(str(error), param_hint="--out") from error
    except SurveyError as error:
        raise typer.BadParameter(str(error), param_hint="FOLDER") from error
    for folder in written.folders:
        session.messages.print(f"wrote {escape(str(folder))}")
    for refusal in written.refusals:
        session.messages.print(f"[bold red]Error:[/] {escape(refusal)}")
    return ExitCode.ERROR if written.refusals else worst_of(codes)


def _maps_of(client: PanolocClient, question: Question) -> Iterator[JsonObject]:
    if question.tag is not None:
        yield from client.list_maps(question.tag)
    for each in question.map_ids:
        yield client.get_map(each)


@dataclass
class _Placing:
    """One run: sends what has no result yet, a few photos at a time."""

    session: Session
    client: PanolocClient
    placed: PlaceFolder
    stopped: threading.Event = field(default_factory=threading.Event)
    _has_answers: bool = False
    _has_told_of_waiting: bool = False

    def run(self, parallel: int) -> list[ExitCode]:
        """Bring every photo to a result and tell of them; raises what says nothing of a photo, with the results so far kept."""
        files = self.placed.files()
        names, unread = files.photos, _several(files.unread, " cannot be read; write photos as JPEG, PNG or WebP")
        if not names:
            endings, folder = ", ".join(sorted(IMAGE_ENDINGS)), self.placed.question.photos
            raise SurveyError(f"expected photos ({endings}), got none in {folder}{': ' if unread else ''}{unread}")
        for left in (unread, _several(files.others, " (no photo by name)")):
            if left:
                self.session.messages.print(f"left alone: {left}", markup=False)
        done = [name for name in names if self.placed.is_final(name)]
        results = {name: result for name in done if (result := self.placed.result(name)) is not None}
        self._has_answers = bool(results)
        if results:
            self.session.messages.print(f"{len(results)} of {counted(len(names))} are done already")
        waiting = [name for name in names if name not in results]
        statuses = Counter(result["status"] for result in results.values())
        with show_counts(self.session.messages, "placing", len(names)) as show:
            show(statuses)
            for name, result in self._localize_all(waiting, parallel):
                statuses[result["status"]] += 1
                show(statuses)
                self._tell(name, result)
        self._keep_maps()
        unplaced = self.placed.write_unplaced()
        self._sum_up(statuses, len(names), unplaced)
        return [exit_code_of(status) for status in statuses]

    def _localize_all(self, names: list[str], parallel: int) -> Iterator[tuple[str, Result]]:
        """Yield each photo with its result as it comes; no more than `parallel` are under way."""
        waiting, under_way = iter(names), dict[Future[Result], str]()
        with ThreadPoolExecutor(parallel) as pool:
            try:
                under_way |= {pool.submit(self.localize, name): name for name in islice(waiting, parallel)}
                while under_way:
                    for future in wait(under_way, return_when=FIRST_COMPLETED).done:
                        yield under_way.pop(future), future.result()
                        under_way |= {pool.submit(self.localize, name): name for name in islice(waiting, 1)}
            except KeyboardInterrupt:
                self.session.messages.print("ends after the photos that are under way; run again, it goes on")
                raise
            finally:
                self.stopped.set()

    def localize(self, name: str) -> Result:
        """Return the result of one photo, once it is kept; what is only a matter of time is tried again for a while."""
        give_up = time.monotonic() + _PATIENCE_S
        while True:
            try:
                question = self.placed.question
                photo = self.placed.photo(name)
                unreadable = _why_unreadable(photo)
                if unreadable is not None:
                    result = {"status": "failed", "error": {"title": "The file cannot be read", "detail": unreadable}}
                    break
                options = photo_options(photo, self.placed.camera(name), question.options)
                answer = self.client.localize([photo], question.map_ids, question.tag, None, options)
                result = {"status": answer["status"], "answer": answer}
                break
            except ApiProblemError as problem:
                if problem.status in _NOT_OF_THE_PHOTO or self._is_of_all(problem):
                    raise
                if problem.status not in _ONLY_TIME:
                    result = {"status": "failed", "error": problem.as_dict()}
                    break
                if time.monotonic() > give_up:
                    raise
                self._tell_of_waiting(problem)
                if self.stopped.wait(problem.retry_after_s or 1.0):
                    raise
        self._has_answers = True
        self.placed.put_result(name, result)
        return result

    def _is_of_all(self, problem: ApiProblemError) -> bool:
        """Tell whether options are refused with which no photo has been answered: they are what is wrong, not the photo."""
        return are_options_refused(problem.problem) and not self._has_answers

    def _tell_of_waiting(self, problem: ApiProblemError) -> None:
        """Say once why nothing comes: a service that starts, or one that others keep busy."""
        if not self._has_told_of_waiting:
            self._has_told_of_waiting = True
            self.session.messages.print(f"waiting for the service: {problem}", markup=False)

    def _keep_maps(self) -> None:
        for map_id in self.placed.maps():
            points = self.client.fetch(f"/maps/{map_id}/points?format=ply&max_points={MAX_SAMPLE_POINTS}")
            self.placed.put_map(self.client.get_map(map_id), points)

    def _tell(self, name: str, result: Result) -> None:
        if self.session.json_output:
            told = result.get("answer") or {"status": "failed", "error": result["error"]}
            self.session.print_json({"photo": name, **told})

    def _sum_up(self, statuses: Counter[str], num_photos: int, unplaced: Path) -> None:
        if self.session.json_output:
            self.session.print_json({"num_photos": num_photos, "counts": dict(statuses), "unplaced": str(unplaced)})
            return
        counts = ", ".join(f"{count} {status.replace('_', ' ')}" for status, count in sorted(statuses.items()))
        self.session.results.print(f"{counted(num_photos)}: {counts or 'none'}", markup=False)
        if statuses["localized"] < num_photos:
            self.session.results.print(f"those without a pose: {unplaced}", markup=False)


def _why_unreadable(photo: Path) -> str | None:
    try:
        with photo.open("rb"):
            return None
    except OSError as error:
        return f"expected a file that can be read, got: {error.strerror}"


def _several(names: list[str], said: str) -> str:
    """Return the first of these files and how many more there are, with what is said of them; nothing of none."""
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{names[0]}{more}{said}" if names else ""


def counted(num_photos: int) -> str:
    """Return a number of photos in words."""
    return f"{num_photos} photo" if num_photos == 1 else f"{num_photos} photos"
