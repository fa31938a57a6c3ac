"""Options that `panoloc localize` and `panoloc place` share, and how they become those of the HTTP API."""

import json
from pathlib import Path
from typing import Annotated

import typer

from panoloc.core.camera.camera import CameraDescription
from panoloc.core.errors import OptionsError
from panoloc.core.options import Method
from panoloc.service.client import JsonObject

MapOption = Annotated[list[str] | None, typer.Option("--map", help="Map to search; repeatable.")]
TagOption = Annotated[str | None, typer.Option(help="Search all maps with this tag instead.")]
MethodOption = Annotated[Method, typer.Option(help="fast, or the paper's own recipe.")]
UprightOption = Annotated[bool, typer.Option("--upright", help="Hint: the camera is level.")]
HfovOption = Annotated[
    str | None,
    typer.Option(
        help="Field of view of photos that are no panoramas, or bounds such as 45-90; default: from EXIF.",
        metavar="DEG",
    ),
]


def check_map_choice(map_ids: list[str] | None, tag: str | None, may_be_all: bool = False) -> None:
    """Raise typer.BadParameter unless maps are chosen by id or by tag, one of both. may_be_all: or by neither, where the service lets that
    mean all maps."""
    if (map_ids and tag) or not (map_ids or tag or may_be_all):
        raise typer.BadParameter(
            f"expected --map ID (repeatable) or --tag TAG, got {'both' if tag else 'neither'}; `panoloc maps` lists them",
            param_hint="--map",
        )


def camera_object(hfov: str | None, file: Path | None) -> JsonObject | None:
    """Return the camera as the HTTP API takes it, None where neither option is given.

    hfov: degrees, or bounds such as 45-90 to search between. Raises typer.BadParameter for what is no camera.
    """
    if file is None:
        return None if hfov is None else _camera_of_hfov(hfov)
    if hfov is not None:
        raise typer.BadParameter(
            "expected either --hfov or --camera, got both; put hfov_deg into the camera file", param_hint="--hfov"
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


def _camera_of_hfov(hfov: str) -> JsonObject:
    # A minus sign in front belongs to the number; only a later one separates two bounds.
    least, dash, most = hfov[1:].partition("-")
    try:
        numbers = [float(part) for part in ((hfov[:1] + least, most) if dash else (hfov,))]
    except ValueError:
        raise typer.BadParameter(
            f"expected degrees such as 69, or bounds such as 45-90 for an unknown field of view, got {hfov!r}",
            param_hint="--hfov",
        ) from None
    try:
        if dash:
            CameraDescription("pinhole", hfov_range_deg=(numbers[0], numbers[1]))
            return {"model": "pinhole", "hfov_range_deg": numbers, "unless_panorama": True}
        CameraDescription("pinhole", hfov_deg=numbers[0])
        return {"model": "pinhole", "hfov_deg": numbers[0], "unless_panorama": True}
    except OptionsError as error:
        raise typer.BadParameter(str(error).partition(": ")[2], param_hint="--hfov") from error


def hints_object(
    position: tuple[float, float, float] | None,
    radius: float | None,
    region: tuple[float, float, float, float, float, float] | None,
    upright: bool,
    max_tilt: float | None,
    heading: float | None,
    heading_tolerance: float | None,
) -> JsonObject:
    """Return the given hints as the HTTP API takes them; metres and degrees.

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
