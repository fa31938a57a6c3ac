"""`panoloc place`: localizes all photos of a folder and writes them in the formats of other systems."""

import json
import threading
import time
from collections import Counter
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from panoloc.core.image.image_header import KNOWN_FORMATS
from panoloc.core.scan.file_names import display_name
from panoloc.service.batches.archive import IMAGE_ENDINGS
from panoloc.service.batches.tour import Photo
from panoloc.service.cli.exit_codes import ExitCode, exit_code_of, worst_of
from panoloc.service.cli.placing.export import (
    IMAGES_AT_A_TIME,
    FormatsOption,
    IncludeAmbiguousOption,
    check_on_earth,
    formats_of,
    is_e57,
    show_refusals,
    take_hand_placements,
)
from panoloc.service.cli.placing.place_folder import PlaceFolder, Question, are_options_refused, is_final
from panoloc.service.cli.placing.placed_photos import PlacedPhotos, ProcessFailedError, run_module, what_was_written
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
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption, make_out_folder
from panoloc.service.client import ApiProblemError, ClientError, JsonClient, JsonObject, UnreachableError
from panoloc.service.jobs import QueryOptions, Result

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
    export: FormatsOption = None,
    include_ambiguous: IncludeAmbiguousOption = False,
    upright: UprightOption = False,
    hfov: HfovOption = None,
    method: MethodOption = QueryOptions.method,
    name: Annotated[
        str | None, typer.Option(help="Name of the batch that the console shows; default: that of FOLDER.")
    ] = None,
    parallel: Annotated[int, typer.Option(min=1, max=32, help="Number of photos sent in parallel.")] = 2,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> int:
    """Localize all photos of a folder. Run the command again to resume an interrupted run."""
    check_map_choice(map_id, tag)
    session = Session.of(ctx, json)
    formats = formats_of(export)
    camera = camera_object(hfov, None)
    options: JsonObject = {"method": method}
    options |= {"hints": {"upright": True}} if upright else {}
    options |= {"cameras": [camera]} if camera else {}
    question = Question(str(_folder_of_photos(photos, out).resolve()), list(map_id or ()), tag, options)
    with session.client(url) as client:
        maps = client.list_maps(tag) if tag else (client.get_map(each) for each in question.map_ids)
        check_on_earth(formats, maps)
        make_out_folder(out)
        with PlaceFolder.held(out, question) as folder:
            try:
                take_hand_placements(client, folder)
            except ApiProblemError as problem:  # such as of a key that may not read batches
                session.messages.print(f"photos placed by hand since are not taken over: {problem}", markup=False)
            placed, codes = _Placing(session, client, folder).run(parallel)
            _keep(session, client, folder, name or photos.resolve().stem)
            pictures = placed.draw_overviews(out)
            written = placed.write_exports(formats, include_ambiguous, out)
    for path in (*pictures.paths, *written.paths):
        session.messages.print(f"wrote {escape(what_was_written(path))}")
    return show_refusals(session, (*pictures.refusals, *written.refusals)) or worst_of(codes)


def _folder_of_photos(given: Path, out: Path) -> Path:
    """Return a folder itself, or `OUT/images` with the images of an E57 file. Raises typer.BadParameter and OSError."""
    if given.is_dir():
        return given
    if not is_e57(given):
        raise _wrong_folder(f"expected a folder of photos or an E57 file, got {given}, which is neither")
    folder = out / "images"
    try:
        found = json.loads(run_module("panoloc.core.scan.e57", str(given), str(folder)))
    except ProcessFailedError as error:
        raise _wrong_folder(str(error)) from error
    if not found["num_images"]:
        raise _wrong_folder(
            f"expected an E57 file with panoramas or pinhole images, got {given} with none "
            f"({found['num_others']} others); export the images with the scanner's software, and pass their folder"
        )
    return folder


def _keep(session: Session, client: JsonClient, folder: PlaceFolder, name: str) -> None:
    """Send the photos with an answer that no batch has yet, with their answers, as batches, which the console shows.

    name: of the batch; several are numbered. That they cannot be made, as where there are too many, does not fail the run.
    """
    unkept = folder.unkept()
    parts = [unkept[first : first + IMAGES_AT_A_TIME] for first in range(0, len(unkept), IMAGES_AT_A_TIME)]
    try:
        for number, photos in enumerate(parts, 1):
            answers = [photo.result["answer"]["id"] for photo in photos if photo.result is not None]
            options = {"name": name if len(parts) == 1 else f"{name} ({number})", "answers": answers}
            images = [(photo.name, photo.image) for photo in photos if photo.image is not None]
            batch = client.make_batch(images, folder.question.map_ids, folder.question.tag, options)
            folder.note_batch(photos, str(batch["id"]))
            session.messages.print(f"kept as batch {batch['id']}, {batch['name']!r} in the console", markup=False)
    except ClientError as error:
        left = f"{len(folder.unkept())} of {len(unkept)} photos, so the console does not show them"
        session.messages.print(f"not kept as a batch: {left}: {error}", markup=False)


def _wrong_folder(message: str) -> typer.BadParameter:
    return typer.BadParameter(message, param_hint="FOLDER")


@dataclass
class _Placing:
    """One run: sends the photos without a result, a few at a time."""

    session: Session
    client: JsonClient
    folder: PlaceFolder
    stopped: threading.Event = field(default_factory=threading.Event)
    _has_answers: bool = False
    _has_said_waiting: bool = False

    def run(self, parallel: int) -> tuple[PlacedPhotos, list[ExitCode]]:
        """Get a result for every photo and show them. Raises errors that are not about one photo; results so far stay."""
        photos = [self.folder.photo(name) for name in self._names()]
        waiting = [photo for photo in photos if not is_final(photo.result)]
        statuses = Counter(photo.result["status"] for photo in photos if photo.result and is_final(photo.result))
        self._has_answers = bool(statuses)
        if statuses:
            self.session.messages.print(f"already done: {statuses.total()} of {_counted(len(photos))}")
        # Closed at once, so that no photo begins after an error.
        with (
            show_counts(self.session.messages, "placing", len(photos)) as show,
            closing(self._localize_all(waiting, parallel)) as results,
        ):
            show(statuses)
            for name, result in results:
                statuses[result["status"]] += 1
                show(statuses)
                if self.session.json_output:
                    shown = result.get("answer") or {"status": "failed", "error": result["error"]}
                    self.session.print_json({"photo": name, **shown})
        placed = self.folder.placed()
        placed.fetch_maps(self.client)
        self._show_summary(statuses, placed.photos, self.folder.write_unplaced(placed.photos))
        return placed, [exit_code_of(status) for status in statuses]

    def _names(self) -> list[str]:
        """Return the names of the photos; show which files are left out."""
        files = self.folder.files()
        unread = _several(files.unread, f" cannot be read; save photos as {KNOWN_FORMATS}")
        if not files.photos:
            endings, folder = ", ".join(sorted(IMAGE_ENDINGS)), self.folder.question.photos
            raise _wrong_folder(f"expected photos ({endings}), got none in {folder}{': ' if unread else ''}{unread}")
        for left_out in filter(None, (unread, _several(files.others, " (not a photo, by its name)"))):
            self.session.messages.print(f"left out: {left_out}", markup=False)
        return files.photos

    def _localize_all(self, photos: Sequence[Photo], parallel: int) -> Generator[tuple[str, Result], None, None]:
        """Yield each photo with its result as it comes; no more than `parallel` are sent at the same time."""
        with ThreadPoolExecutor(parallel) as pool:
            running = {pool.submit(self._localize, photo): photo.name for photo in photos}
            try:
                for future in as_completed(running):
                    yield running[future], future.result()
            except (KeyboardInterrupt, UnreachableError):
                self.session.messages.print("stops after the photos in progress; run again to resume")
                raise
            finally:
                self.stopped.set()
                pool.shutdown(wait=False, cancel_futures=True)

    def _localize(self, photo: Photo) -> Result:
        """Return the result of one photo after storing it. While the service is overloaded, it is asked again."""
        give_up = time.monotonic() + _GIVE_UP_S
        while True:
            try:
                result = self._asked(photo)
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
        self.folder.put_result(photo, result)
        return result

    def _asked(self, photo: Photo) -> Result:
        """Return what the service answers to one photo, or the failure to read its file."""
        assert photo.image is not None
        question = self.folder.question
        try:
            photo.image.open("rb").close()
        except OSError as error:
            detail = f"expected a file that can be read, got: {error.strerror}"
            return {"status": "failed", "error": {"title": "The file cannot be read", "detail": detail}}
        camera = self.folder.camera(photo.name)
        options = ({"cameras": [camera]} if camera else {}) | question.options
        answer = self.client.localize([photo.image], question.map_ids, question.tag, None, options)
        return {"status": answer["status"], "answer": answer}

    def _show_summary(self, statuses: Counter[str], photos: Sequence[Photo], unplaced: Path) -> None:
        num_photos = len(photos)
        if self.session.json_output:
            self.session.print_json({"num_photos": num_photos, "counts": dict(statuses), "unplaced": str(unplaced)})
            return
        self.session.results.print(f"{_counted(num_photos)}: {counts_text(statuses) or 'none'}", markup=False)
        if statuses["localized"] < num_photos:
            self.session.results.print(f"photos without a pose: {unplaced}", markup=False)
        # What failed has no answer; of the others, those without a pose are listed already.
        answers = [(photo.name, (photo.result or {}).get("answer")) for photo in photos]
        warned = [
            f"{display_name(name)}: {answer['warnings'][0]}"
            for name, answer in answers
            if answer and answer["status"] == "localized" and answer["warnings"]
        ]
        if warned:
            self.session.results.print(f"placed, with warnings (results/): {_several(warned, '')}", markup=False)


def _several(names: list[str], note: str) -> str:
    """Return the first name, how many more there are, and a note; nothing for no names."""
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{names[0]}{more}{note}" if names else ""


def _counted(num_photos: int) -> str:
    return f"{num_photos} photo" if num_photos == 1 else f"{num_photos} photos"
