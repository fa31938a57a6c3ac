"""The hints of `panoloc localize` as the object that the HTTP API takes."""

import typer

from service.client.client import JsonObject


def hints_object(
    position: tuple[float, float, float] | None,
    radius: float | None,
    region: tuple[float, float, float, float, float, float] | None,
    upright: bool,
    max_tilt: float | None,
    heading: float | None,
    heading_tolerance: float | None,
) -> JsonObject:
    """Return only the hints that were given; metres and degrees.

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
