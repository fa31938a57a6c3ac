"""Maps and answers as tables for people."""

from collections.abc import Iterable, Sequence

from rich import filesize
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
        stats = place.get("stats") or {}
        table.add_row(
            place["id"],
            escape(place.get("name") or ""),
            _status_of_map(place),
            escape(", ".join(place.get("tags") or [])),
            _count(stats.get("num_points")),
            _count(stats.get("num_starts")),
            _size(stats.get("index_bytes")),
        )
    return _folding(table)


def map_summary(place: JsonObject) -> Table:
    """Return one map as a table: its id first, then what was found in the scan."""
    stats = place.get("stats") or {}
    rows: list[tuple[str, str | Text]] = [("map", Text(place["id"], "bold")), ("name", place.get("name") or "")]
    rows.append(("status", _status_of_map(place)))
    if stats.get("num_points") is not None:
        rows.append(
            ("points", f"{_count(stats['num_points'])} in the scan, {_count(stats.get('num_points_used'))} used")
        )
    if stats.get("num_starts") is not None:
        rows.append(("starts", _count(stats["num_starts"])))
    if stats.get("index_bytes") is not None:
        rows.append(("index", _size(stats["index_bytes"])))
    rows += [(entry.get("severity", "note"), str(entry.get("message", ""))) for entry in place.get("diagnostics") or []]
    return _two_columns(rows)


def answer_summary(answer: JsonObject) -> Table:
    """Return one localization as a table."""
    rows: list[tuple[str, str | Text]] = [("status", styled_status(answer["status"]))]
    pose = answer.get("pose")
    if pose:
        rows.append(("position", _position(pose)))
        rows.append(("orientation", _angles(pose)))
        if pose.get("heading_deg") is not None:
            rows.append(("looks to", _photo_angles(pose)))
        rows.append(("frame", str(pose.get("frame"))))
    rows.append(("map", str(answer.get("map_id") or "none")))
    if answer.get("confidence") is not None:
        rows.append(("confidence", f"{answer['confidence']:.2f}"))
    accuracy = answer.get("accuracy") or {}
    if pose and accuracy.get("position_m") is not None and accuracy.get("orientation_deg") is not None:
        rows.append(("accuracy", _accuracy(accuracy)))
    motion = answer.get("map_from_session")
    if motion and len(answer.get("images") or ()) > 1:
        rows.append(("map from session", _motion(motion)))
    change = answer.get("change") or {}
    if pose and change.get("panorama_changed_fraction") is not None:
        rows.append(("changed", f"{change['panorama_changed_fraction']:.0%} of {_what_is_shown(answer)}"))
    rows.append(("seconds", _seconds(answer.get("timings_s") or {})))
    rows += [("warning", str(warning)) for warning in answer.get("warnings") or []]
    return _two_columns(rows)


def images_table(answer: JsonObject, names: Sequence[str]) -> Table | None:
    """Return the images of a session with their poses, one per row; None for a single image. names: of their files."""
    images = answer.get("images") or []
    if len(images) < 2:
        return None
    table = Table("image", "position", "orientation", "agreement", box=None, pad_edge=False, header_style="dim")
    for number, image in enumerate(images):
        pose, agreement = image.get("pose"), image.get("agreement")
        table.add_row(
            escape(names[number]) if number < len(names) else str(number + 1),
            _position(pose) if pose else "",
            _angles(pose) if pose else "",
            "" if agreement is None else f"{agreement:.2f}",
        )
    return _folding(table)


def alternatives_table(answer: JsonObject) -> Table | None:
    """Return the other poses of one localization, best first, one per row; None when it has none."""
    alternatives = answer.get("alternatives") or []
    if not alternatives:
        return None
    headings = (
        Column("alternative", justify="right"),
        "position",
        "orientation",
        "confidence",
        Column("map", no_wrap=True),
    )
    table = Table(*headings, box=None, pad_edge=False, header_style="dim")
    for number, each in enumerate(alternatives, 1):
        confidence = each.get("confidence")
        table.add_row(
            str(number),
            _position(each["pose"]),
            _angles(each["pose"]),
            "" if confidence is None else f"{confidence:.2f}",
            str(each.get("map_id") or ""),
        )
    return _folding(table)


def styled_status(status: str) -> Text:
    """Return the status in its colour."""
    return Text(status.replace("_", " "), _STATUS_STYLES.get(status, ""))


def older_revision(place: JsonObject) -> int | None:
    """Return the older revision that answers queries while the newest is not ready or has failed, None where none does."""
    serving: int | None = place.get("serving_revision")
    return None if serving == place.get("revision") else serving


def _status_of_map(place: JsonObject) -> Text:
    status, older = place["status"], older_revision(place)
    if status in ("reading", "indexing") and place.get("progress") is not None:
        newest = Text(f"{status} {place['progress']:.0%}")
    else:
        newest = styled_status(status)
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


def _position(pose: JsonObject) -> str:
    centre = pose["map_from_camera"]["position_m"]
    return f"x {centre['x']:.3f}   y {centre['y']:.3f}   z {centre['z']:.3f} m"


def _motion(motion: JsonObject) -> str:
    quaternion = "   ".join(f"{axis} {motion['quaternion'][axis]:.5f}" for axis in "xyzw")
    return f"{_position({'map_from_camera': motion})}   quaternion {quaternion}"


def _what_is_shown(answer: JsonObject) -> str:
    images = answer.get("images") or []
    if len(images) > 1:
        return "what the images show"
    part = any(((image.get("camera") or {}).get("hfov_deg") or 360) < _WHOLE_TURN_DEG for image in images)
    return "what the photo shows" if part else "the panorama"


def _angles(pose: JsonObject) -> str:
    return f"yaw {pose['yaw_deg']:.2f}   pitch {pose['pitch_deg']:.2f}   roll {pose['roll_deg']:.2f} deg"


def _photo_angles(pose: JsonObject) -> str:
    north = "true north" if pose["north"] == "true" else "the map's y axis"
    tilted = f"elevation {pose['elevation_deg']:.2f}   roll {pose['camera_roll_deg']:.2f} deg"
    return f"heading {pose['heading_deg']:.2f} from {north}   {tilted}"


def _accuracy(accuracy: JsonObject) -> str:
    level = accuracy.get("level")
    chance = f" ({level:.0%} radius)" if level is not None else ""
    return f"{accuracy['position_m']:.3f} m, {accuracy['orientation_deg']:.2f} deg{chance}"


def _seconds(timings: JsonObject) -> str:
    known = {name: seconds for name, seconds in timings.items() if seconds is not None}
    total = known.pop("total", None)
    stages = ", ".join(f"{name} {seconds:.2f}" for name, seconds in known.items())
    return f"{total:.2f} ({stages})" if total is not None else stages


def _count(number: int | None) -> str:
    return "" if number is None else f"{number:,}"


def _size(num_bytes: int | None) -> str:
    return "" if num_bytes is None else filesize.decimal(num_bytes)
