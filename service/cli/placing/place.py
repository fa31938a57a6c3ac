"""`panoloc place`: localizes all photos of a folder and writes them in the formats of other systems."""

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

from panoloc.core.errors import CoreError
from panoloc.service.batches.archive import IMAGE_ENDINGS
from panoloc.service.cli.exit_codes import ExitCode, exit_code_of, worst_of
from panoloc.service.cli.placing.export import check_on_earth, formats_of, show_refusals, write_exports
from panoloc.service.cli.placing.place_folder import PlaceFolder, Question, are_options_refused
from panoloc.service.cli.placing.processes import draw_overviews, folder_of_photos
from panoloc.service.cli.progress import counts_text, show_counts
from panoloc.service.cli.query_options import (
    HfovOption,
    MapOption,
    MethodOption,
    TagOption,
    UprightOption,
    camera_object,
    check_map_choice,
)
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption
from panoloc.service.client import ApiProblemError, JsonObject, PanolocClient
from panoloc.service.jobs import MAX_SAMPLE_POINTS, QueryOptions, Result

# Statuses about the key or the map: every other photo would fail in the same way.
_OF_ALL_PHOTOS = (401, 403, 404, 409)
_OVERLOADED = (429, 503)
_RETRY_S, _GIVE_UP_S = 1.0, 600.0


def place(
    ctx: typer.Context,
    photos: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER", exists=True, help="Folder of photos, with its subfolders; or an E57 file with images."
        ),
    ],
    out: Annotated[
        Path, typer.Option(file_okay=False, help="Folder for results and exports; a second run resumes there.")
    ],
    map_id: MapOption = None,
    tag: TagOption = None,
    export: Annotated[
        str | None,
        typer.Option(
            metavar="FORMATS", help="Formats, separated by commas, such as potree,colmap; see docs/exports.md."
        ),
    ] = None,
    include_ambiguous: Annotated[
        bool, typer.Option("--include-ambiguous", help="Also export ambiguous photos, at the most likely place.")
    ] = False,
    upright: UprightOption = False,
    hfov: HfovOption = None,
    method: MethodOption = QueryOptions.method,
    parallel: Annotated[int, typer.Option(min=1, max=32, help="Number of photos sent in parallel.")] = 2,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Localize all photos of a folder. Run the command again to resume an interrupted run."""
    check_map_choice(map_id, tag)
    session: Session = ctx.obj
    session.json_output = json
    formats = formats_of(export)
    camera = camera_object(hfov, None)
    options: JsonObject = {"method": method}
    options |= {"hints": {"upright": True}} if upright else {}
    options |= {"cameras": [camera]} if camera else {}
    question = Question(str(folder_of_photos(photos, out).resolve()), list(map_id or ()), tag, options)
    with session.client(url) as client:
        maps = client.list_maps(tag) if tag else (client.get_map(each) for each in question.map_ids)
        check_on_earth(formats, maps)
        with PlaceFolder.held(out, question) as placed:
            codes = _Placing(session, client, placed).run(parallel)
            pictures, failures = draw_overviews(placed)
            written = write_exports(placed, formats, include_ambiguous, out)
    for path in (*pictures, *written.paths):
        session.messages.print(f"wrote {escape(str(path))}")
    return show_refusals(session, (*failures, *written.refusals)) or worst_of(codes)


@dataclass
class _Placing:
    """One run: sends the photos without a result, a few at a time."""

    session: Session
    client: PanolocClient
    placed: PlaceFolder
    stopped: threading.Event = field(default_factory=threading.Event)
    _has_answers: bool = False
    _has_said_waiting: bool = False

    def run(self, parallel: int) -> list[ExitCode]:
        """Get a result for every photo and show them. Raises errors that are not about one photo; results so far stay."""
        names = self._photos()
        done = [name for name in names if self.placed.is_final(name)]
        results = {name: result for name in done if (result := self.placed.result(name)) is not None}
        self._has_answers = bool(results)
        if results:
            self.session.messages.print(f"{len(results)} of {_counted(len(names))} are already done")
        statuses = Counter(result["status"] for result in results.values())
        with show_counts(self.session.messages, "placing", len(names)) as show:
            show(statuses)
            for name, result in self._localize_all([name for name in names if name not in results], parallel):
                statuses[result["status"]] += 1
                show(statuses)
                if self.session.json_output:
                    shown = result.get("answer") or {"status": "failed", "error": result["error"]}
                    self.session.print_json({"photo": name, **shown})
        for map_id in self.placed.maps():
            points = self.client.fetch(f"/maps/{map_id}/points?format=ply&max_points={MAX_SAMPLE_POINTS}")
            self.placed.put_map(self.client.get_map(map_id), points)
        self._show_summary(statuses, len(names), self.placed.write_unplaced())
        return [exit_code_of(status) for status in statuses]

    def _photos(self) -> list[str]:
        """Return the names of the photos; show which files are left out."""
        files = self.placed.files()
        unread = _several(files.unread, " cannot be read; save photos as JPEG, PNG or WebP")
        if not files.photos:
            endings, folder = ", ".join(sorted(IMAGE_ENDINGS)), self.placed.question.photos
            raise typer.BadParameter(
                f"expected photos ({endings}), got none in {folder}{': ' if unread else ''}{unread}",
                param_hint="FOLDER",
            )
        for left_out in filter(None, (unread, _several(files.others, " (not a photo, by its name)"))):
            self.session.messages.print(f"left out: {left_out}", markup=False)
        return files.photos

    def _localize_all(self, names: list[str], parallel: int) -> Iterator[tuple[str, Result]]:
        """Yield each photo with its result as it comes; no more than `parallel` are sent at the same time."""
        waiting, running = iter(names), dict[Future[Result], str]()
        with ThreadPoolExecutor(parallel) as pool:
            try:
                running |= {pool.submit(self._localize, name): name for name in islice(waiting, parallel)}
                while running:
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        yield running.pop(future), future.result()
                        running |= {pool.submit(self._localize, name): name for name in islice(waiting, 1)}
            except KeyboardInterrupt:
                self.session.messages.print("stops after the photos in progress; run again to resume")
                raise
            finally:
                self.stopped.set()

    def _localize(self, name: str) -> Result:
        """Return the result of one photo after storing it. While the service is overloaded, it is asked again."""
        give_up = time.monotonic() + _GIVE_UP_S
        while True:
            try:
                result = self._asked(name)
                break
            except ApiProblemError as problem:
                # Options refused before any photo was answered are wrong for all photos.
                is_of_all = are_options_refused(problem.problem) and not self._has_answers
                if problem.status in _OF_ALL_PHOTOS or is_of_all:
                    raise
                if problem.status not in _OVERLOADED:
                    result = {"status": "failed", "error": problem.as_dict()}
                    break
                if not self._has_said_waiting:
                    self._has_said_waiting = True
                    self.session.messages.print(f"waiting for the service: {problem}", markup=False)
                if time.monotonic() > give_up or self.stopped.wait(problem.retry_after_s or _RETRY_S):
                    raise
        self._has_answers = True
        self.placed.put_result(name, result)
        return result

    def _asked(self, name: str) -> Result:
        """Return what the service answers to one photo, or the failure to read its file."""
        photo, question = self.placed.photo(name), self.placed.question
        try:
            photo.open("rb").close()
        except OSError as error:
            detail = f"expected a file that can be read, got: {error.strerror}"
            return {"status": "failed", "error": {"title": "The file cannot be read", "detail": detail}}
        options = photo_options(photo, self.placed.camera(name), question.options)
        answer = self.client.localize([photo], question.map_ids, question.tag, None, options)
        return {"status": answer["status"], "answer": answer}

    def _show_summary(self, statuses: Counter[str], num_photos: int, unplaced: Path) -> None:
        if self.session.json_output:
            self.session.print_json({"num_photos": num_photos, "counts": dict(statuses), "unplaced": str(unplaced)})
            return
        self.session.results.print(f"{_counted(num_photos)}: {counts_text(statuses) or 'none'}", markup=False)
        if statuses["localized"] < num_photos:
            self.session.results.print(f"photos without a pose: {unplaced}", markup=False)


def photo_options(photo: Path, camera: JsonObject | None, asked: JsonObject) -> JsonObject:
    """Return the options for one photo.

    camera: from `cameras.json`. asked: the options for all photos, which win; but a field of view is not for panoramas.
    """
    options = {**({"cameras": [camera]} if camera else {}), **asked}
    if camera is None and "cameras" in asked and _is_panorama(photo):
        del options["cameras"]
    return options


def _is_panorama(photo: Path) -> bool:
    # Commands load these modules only when they need them.
    from panoloc.core.panorama.image_header import read_image_header
    from panoloc.core.panorama.known_camera import is_full_sphere

    try:
        header = read_image_header(photo.read_bytes())
    except (CoreError, OSError):
        return False  # the service says what is wrong with it
    return is_full_sphere((header.width, header.height))


def _several(names: list[str], note: str) -> str:
    """Return the first name, how many more there are, and a note; nothing for no names."""
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{names[0]}{more}{note}" if names else ""


def _counted(num_photos: int) -> str:
    return f"{num_photos} photo" if num_photos == 1 else f"{num_photos} photos"
