"""Maps, answers and control points as tables for people."""

from collections.abc import Iterable, Sequence

from rich import filesize
from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Column, Table
from rich.text import Text

from panoloc.service.client import JsonObject

_WHOLE_TURN_DEG = 359.5

_STATUS_STYLES = {
    "ready": "green",
    "failed": "bold red",
    "localized": "bold green",
    "ambiguous": "bold yellow",
    "not_localized": "bold red",
}


def map_table(places: Iterable[JsonObject]) -> Table:
    """Return one row per map."""
    # An id that is broken over two lines cannot be copied.
    headings = (Column("id", no_wrap=True), "name", "status", "tags")
    numbers = (Column(name, justify="right") for name in ("points", "starts", "index"))
    table = Table(*headings, *numbers, box=None, pad_edge=False, header_style="bold")
    for place in places:
        row = [place["id"], escape(place["name"]), _status_of_map(place), escape(", ".join(place["tags"]))]
        if stats := place["stats"]:
            row += [f"{stats['num_points']:,}", f"{stats['num_starts']:,}", filesize.decimal(stats["index_bytes"])]
        table.add_row(*row)
    return _folding(table)


def map_summary(place: JsonObject) -> Table:
    """Return one map as a table: its id first, then what was found in the scan."""
    rows: list[tuple[str, str | Text]] = [("map", Text(place["id"], "bold")), ("name", place["name"])]
    rows.append(("status", _status_of_map(place)))
    if stats := place["stats"]:
        rows.append(("points", f"{stats['num_points']:,} in the scan, {stats['num_points_used']:,} used"))
        rows.append(("starts", f"{stats['num_starts']:,}"))
        rows.append(("index", filesize.decimal(stats["index_bytes"])))
    rows += [(entry["severity"], entry["message"]) for entry in place["diagnostics"]]
    return _two_columns(rows)


def answer_summary(answer: JsonObject) -> Table:
    """Return one localization as a table."""
    rows: list[tuple[str, str | Text]] = [("status", styled_status(answer["status"]))]
    pose, accuracy, changed = answer["pose"], answer["accuracy"], answer["change"]["panorama_changed_fraction"]
    if pose:
        rows += [("position", _position(pose["map_from_camera"])), ("orientation", _angles(pose))]
        rows += [("looks to", _photo_angles(pose)), ("frame", pose["frame"])]
    rows += [("map", answer["map_id"] or "none"), ("confidence", f"{answer['confidence']:.2f}")]
    if pose and accuracy and None not in accuracy.values():
        radii = f"{accuracy['position_m']:.3f} m, {accuracy['orientation_deg']:.2f} deg"
        rows.append(("accuracy", f"{radii} ({accuracy['level']:.0%} radius)"))
    motion = answer["map_from_session"]
    if motion and len(answer["images"]) > 1:
        quaternion = "   ".join(f"{axis} {motion['quaternion'][axis]:.5f}" for axis in "xyzw")
        rows.append(("map from session", f"{_position(motion)}   quaternion {quaternion}"))
    if pose and changed is not None:
        rows.append(("changed", f"{changed:.0%} of {_what_is_shown(answer['images'])}"))
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in answer["timings_s"].items() if name != "total")
    rows.append(("seconds", f"{answer['timings_s']['total']:.2f} ({stages})"))
    rows += [("warning", warning) for warning in answer["warnings"]]
    return _two_columns(rows)


def images_table(answer: JsonObject, names: Sequence[str]) -> Table | None:
    """Return the images of a session with their poses, one per row; None for a single image. names: of their files."""
    images = answer["images"]
    if len(images) < 2:
        return None
    table = Table("image", "position", "orientation", "agreement", box=None, pad_edge=False, header_style="dim")
    for name, image in zip(names, images, strict=True):
        pose, agreement = image["pose"], image["agreement"]
        shown = (_position(pose["map_from_camera"]), _angles(pose)) if pose else ("", "")
        table.add_row(escape(name), *shown, "" if agreement is None else f"{agreement:.2f}")
    return _folding(table)


def alternatives_table(answer: JsonObject) -> Table | None:
    """Return the other poses of one localization, best first, one per row; None when it has none."""
    if not answer["alternatives"]:
        return None
    number, map_id = Column("alternative", justify="right"), Column("map", no_wrap=True)
    headings = (number, "position", "orientation", "confidence", map_id)
    table = Table(*headings, box=None, pad_edge=False, header_style="dim")
    for rank, each in enumerate(answer["alternatives"], 1):
        pose, confidence = each["pose"], f"{each['confidence']:.2f}"
        table.add_row(str(rank), _position(pose["map_from_camera"]), _angles(pose), confidence, each["map_id"])
    return _folding(table)


def styled_status(status: str) -> Text:
    """Return the status in its colour."""
    return Text(status.replace("_", " "), _STATUS_STYLES.get(status, ""))


def older_revision(place: JsonObject) -> int | None:
    """Return the older revision that answers queries while the newest is not ready or has failed, None where none does."""
    serving: int | None = place["serving_revision"]
    return None if serving == place["revision"] else serving


def _status_of_map(place: JsonObject) -> Text:
    status, older = place["status"], older_revision(place)
    is_under_way = status in ("reading", "indexing")
    newest = Text(f"{status} {place['progress']:.0%}") if is_under_way else styled_status(status)
    if older is None:
        return newest
    return Text.assemble(f"revision {place['revision']} ", newest, f"; {older} still answers")


def _two_columns(rows: list[tuple[str, str | Text]]) -> Table:
    table = Table(Column(style="dim"), Column(), box=None, show_header=False, pad_edge=False)
    for label, value in rows:
        table.add_row(label, value if isinstance(value, Text) else Text(value))
    return _folding(table)


def _folding(table: Table) -> Table:
    """Let long values continue on the next line: nothing is cut off."""
    for column in table.columns:
        column.overflow = "fold"
    return table


def _position(motion: JsonObject) -> str:
    centre = motion["position_m"]
    return f"x {centre['x']:.3f}   y {centre['y']:.3f}   z {centre['z']:.3f} m"


def _angles(pose: JsonObject) -> str:
    return f"yaw {pose['yaw_deg']:.2f}   pitch {pose['pitch_deg']:.2f}   roll {pose['roll_deg']:.2f} deg"


def _photo_angles(pose: JsonObject) -> str:
    north = "true north" if pose["north"] == "true" else "the map's y axis"
    tilted = f"elevation {pose['elevation_deg']:.2f}   roll {pose['camera_roll_deg']:.2f} deg"
    return f"heading {pose['heading_deg']:.2f} from {north}   {tilted}"


def _what_is_shown(images: Sequence[JsonObject]) -> str:
    if len(images) > 1:
        return "what the images show"
    return "what the photo shows" if images[0]["camera"]["hfov_deg"] < _WHOLE_TURN_DEG else "the panorama"


def control_table(report: JsonObject, is_applied: bool = False) -> RenderableType:
    """Return one row per point: residuals as the map stands, and after the fit, millimetres; then what to know and do.

    is_applied: the map stands by the fit now.
    """
    axes = ("east", "north", "up") if report["is_on_earth"] else ("x", "y", "z")
    of_as_is, of_fit = report["as_is"] is not None, report["fit"] is not None
    headings = [f"{axis} mm" for axis in (*axes, "3D")]
    columns = ["point", *(headings if of_as_is else []), *([f"fit {each}" for each in headings] if of_fit else [])]
    columns += ["left out mm"] if of_fit else []
    table = Table(
        *(Column(name, justify="left" if name == "point" else "right") for name in columns), box=None, pad_edge=False
    )
    table.header_style = "bold"
    for point in report["points"]:
        row = [point["name"], *(_residuals(point["as_is"]) if of_as_is else [])]
        row += [*_residuals(point["fitted"]), _mm(point["left_out_m"])] if of_fit else []
        table.add_row(*map(Text, row))
    return Group(table, *(Text(words_here(line)) for line in _lines(report, is_applied)))


def _lines(report: JsonObject, is_applied: bool) -> list[str]:
    lines = []
    for kind, words in (("as_is", "as the map stands"), ("fit", "after the fit")):
        if (found := report[kind]) is not None:
            horizontal, up, total = (1000 * found[name] for name in ("rms_horizontal_m", "rms_up_m", "rms_m"))
            lines.append(
                f"RMS {words}, {found['num_points']} points: horizontal {horizontal:.1f}, up {up:.1f}, 3D {total:.1f} mm"
            )
    if (fit := report["fit"]) is not None:
        ppm, left_out = (fit["scale"] - 1) * 1e6, 1000 * fit["rms_left_out_m"]
        lines.append(
            f"left out one by one: RMS {left_out:.1f} mm; scale {ppm:+.0f} ppm; tilt {fit['tilt_deg']:.2f} deg"
        )
        if (place := fit["georeference"]) is not None:
            at = f"{place['latitude_deg']:.8f}, {place['longitude_deg']:.8f}, {place['height_m']:.3f} m"
            wrong = f"mend or remove {report['suspect']} first" if report["suspect"] else "--apply sets it"
            then = "the map has it now" if is_applied else wrong
            lines.append(f"georeference by the fit: {at}, heading {place['heading_deg']:.4f} deg; {then}")
    open_points = [point["name"] for point in report["points"] if point["position_m"] is None]
    if open_points:
        named = ", ".join(open_points[:5]) + (" …" if len(open_points) > 5 else "")
        lines.append(f"without a place in the scan: {named}; click it in the console, or add map_x, map_y, map_z")
    reasons = (
        [report["no_fit"]] if report["no_fit"] else [report["no_georeference"]] if report["no_georeference"] else []
    )
    return [
        *lines,
        *(f"no {'fit' if report['no_fit'] else 'georeference'}: {each}" for each in reasons),
        *report["warnings"],
    ]


def words_here(text: str) -> str:
    """Return a message of the service with the option of the command in place of the field of the API."""
    return text.replace("geoid_undulation_m", "--geoid-undulation")


def _residuals(found: JsonObject | None) -> list[str]:
    names = ("east_m", "north_m", "up_m", "distance_m")
    return [_mm(None if found is None else found[name]) for name in names]


def _mm(metres: float | None) -> str:
    return "–" if metres is None else f"{1000 * metres:.1f}"
