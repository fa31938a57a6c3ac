"""Control points and their residuals as a table for people."""

from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from panoloc.service.client import JsonObject


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
