"""`panoloc demo`: the whole way once, in a procedural room whose poses are known exactly."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from panoloc.lab.background_service import BackgroundService, start_in_background, wait_until_ready
from panoloc.lab.display import session_of
from panoloc.service.cli.exit_codes import ExitCode, exit_code_of, worst_of
from panoloc.service.cli.localize import save_answer
from panoloc.service.cli.progress import show_waiting
from panoloc.service.cli.register import upload_and_wait
from panoloc.service.cli.session import DEFAULT_URL, JsonOption, Session, UrlOption, make_out_folder
from panoloc.service.cli.tables import map_summary
from panoloc.service.client import JsonClient, JsonObject
from panoloc.service.jobs import ARTIFACTS

if TYPE_CHECKING:
    from panoloc.lab.demo_room import DemoQuery

LOCALIZE_TIMEOUT_S = 120.0


def demo(
    ctx: typer.Context,
    folder: Annotated[
        Path, typer.Option(file_okay=False, help="Folder for the scan, the images and the answers.")
    ] = Path("panoloc-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the room.")] = 4,
    url: UrlOption = DEFAULT_URL,
    json: JsonOption = False,
) -> ExitCode:
    """Make a furnished room, register its scan, localize two panoramas and a photo, and check the resulting poses.

    Uses the service at --url; where none runs on this machine, one is started and left running.
    """
    with session_of(ctx, json) as session:
        return _run(session, folder, seed, url)


def _run(session: Session, folder: Path, seed: int, url: str) -> ExitCode:
    """Make a room, register it, localize in it, and say what keeps running."""
    # The generator needs numpy and a ray caster, which client commands must not load.
    from panoloc.lab.demo_room import make_demo_scene
    from panoloc.lab.rooms.scenes.surface import load_open3d

    load_open3d()  # before a service is started that nothing could be shown with

    with session.client(url) as client:
        service = None if client.is_live() else start_in_background(url, folder / "service.log")
        # A service of ours is left running only when the demo went through.
        with ExitStack() as failure:
            if service is not None:
                failure.callback(service.stop)
                session.messages.print(f"No service at {url}: starting one (log: {escape(str(service.log_file))}).")
            with show_waiting(session.messages, "making a room") as say:
                scene = make_demo_scene(folder, seed, say)
            names = ", ".join([scene.scan.name, *(query.image.name for query in scene.queries)])
            session.messages.print(f"Made a room in {escape(str(folder))}: {names}")
            with show_waiting(session.messages, "waiting for the service") as say:
                wait_until_ready(client, service, say)
            options: JsonObject = {"name": f"demo room {seed}", "tags": ["demo"]}
            place = upload_and_wait(session, client, scene.scan, options, wait=True)
            if not session.json_output:
                session.results.print(map_summary(place))
            answers = folder / "answers"
            make_out_folder(answers)
            codes = [(query, _localize(session, client, place["id"], answers, query)) for query in scene.queries]
            failure.pop_all()
    _say_what_remains(session, url, service, place["id"])
    return worst_of([code for query, code in codes if not query.may_stay_open])


def _localize(session: Session, client: JsonClient, map_id: str, folder: Path, query: "DemoQuery") -> ExitCode:
    """Localize one image, save its pictures, and show the pose beside the known one."""
    with show_waiting(session.messages, f"localizing {query.image.name}"):
        options: JsonObject = {"artifacts": list(ARTIFACTS), "timeout_s": LOCALIZE_TIMEOUT_S, **query.options}
        answer = client.localize(query.image, [map_id], options=options)
    saved = save_answer(folder, query.image.stem, [query.image], answer, client)
    position_m, orientation_deg = query.error_of(answer)
    if session.json_output:
        error = {"position_m": position_m, "orientation_deg": orientation_deg}
        session.print_json({"image": str(query.image), "error_to_truth": error, **answer})
        return exit_code_of(answer["status"])
    show = session.results.print
    show(f"\n[bold]{escape(str(query.image))}[/]: {query.description}")
    session.show_answer(answer, client)
    if position_m is not None and orientation_deg is not None:
        show(f"[bold]off by {position_m * 100:.1f} cm and {orientation_deg:.2f} degrees[/] from the known pose")
    session.messages.print(f"saved {', '.join(escape(str(path)) for path in saved)}")
    return exit_code_of(answer["status"])


def _say_what_remains(session: Session, url: str, service: BackgroundService | None, map_id: str) -> None:
    show = session.messages.print
    show(
        f"\nThe service runs at {url} (try {url}/docs). Localize another panorama in this room, or register your scan:"
    )
    show(f"  panoloc localize PANORAMA --map {map_id} --out answers", markup=False)
    show("  panoloc register SCAN", markup=False)
    if service is not None:
        show(f"Stop it with: kill {service.process.pid}")
