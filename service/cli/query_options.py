"""What the options of `panoloc localize` say, as the HTTP API takes it."""

import json
from pathlib import Path

import typer

from core.camera.camera import CameraDescription
from core.errors import CoreError, OptionsError
from service.client import JsonObject


def camera_object(hfov: str | None, file: Path | None) -> JsonObject | None:
    """Return the camera as the HTTP API takes it, None where nothing is said of it.

    hfov: degrees, or bounds such as 45-90 within which they are searched. Raises typer.BadParameter for what is no camera.
    """
    if file is None:
        return None if hfov is None else _photo_of(hfov)
    if hfov is not None:
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


def photo_options(photo: Path, camera: JsonObject | None, asked: JsonObject) -> JsonObject:
    """Return the options of one photo of a folder.

    camera: what the folder says took it. asked: for all photos, which goes before that; but a field of view is not meant for the
    panoramas among them.
    """
    options = {**({"cameras": [camera]} if camera else {}), **asked}
    if camera is None and "cameras" in asked and _is_panorama(photo):
        del options["cameras"]
    return options


def _is_panorama(photo: Path) -> bool:
    # Of all commands `place` alone asks for the size of images, and only where it has to.
    from core.panorama.image_header import read_image_header
    from core.panorama.known_camera import is_full_sphere

    try:
        header = read_image_header(photo.read_bytes())
    except (CoreError, OSError):
        return False  # the service says what is wrong with it
    return is_full_sphere((header.width, header.height))


def _photo_of(hfov: str) -> JsonObject:
    try:
        # A minus sign in front is none between two bounds.
        least, dash, most = hfov[1:].partition("-")
        numbers = [float(part) for part in ((hfov[:1] + least, most) if dash else (hfov,))]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise typer.BadParameter(
            f"expected degrees such as 69, or bounds such as 45-90 where nobody knows them, got {hfov!r}",
            param_hint="--hfov",
        )
    try:
        if len(numbers) == 1:
            CameraDescription("pinhole", hfov_deg=numbers[0])
            return {"model": "pinhole", "hfov_deg": numbers[0]}
        CameraDescription("pinhole", hfov_range_deg=(numbers[0], numbers[1]))
        return {"model": "pinhole", "hfov_range_deg": numbers}
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
