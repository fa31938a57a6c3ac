"""The registry of formats: what each can hold, and the entry to all of them."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from panoloc.core.errors import ExportRefusedError
from panoloc.core.exports import colmap, e57, earth, gpano, plan, reconstruction, robots, viewers, walk, web_tours
from panoloc.core.exports.tour import ExportedFile, LeftOut, PlacedPhoto, Tour
from panoloc.core.options import FORMATS_ON_EARTH, ExportFormat
from panoloc.core.scan.file_names import display_name

North = Literal["map", "grid", "true"]


@dataclass(frozen=True)
class Exporter:
    """What a format can hold. why_not: says of a photo why it cannot be written, None: it can.
    uses_place: writes east, north, up where the map has a place on Earth. uses_grid: writes a map in a coordinate system in its own axes.
    """

    write: Callable[[Tour], Iterator[ExportedFile]]
    why_not: Callable[[PlacedPhoto], str | None] | None = None
    spheres_only: bool = True
    uses_place: bool = False
    uses_grid: bool = False


EXPORTERS: dict[ExportFormat, Exporter] = {
    "tour": Exporter(walk.write, walk.why_not, spheres_only=False),
    "plan": Exporter(plan.write, spheres_only=False),
    "potree": Exporter(web_tours.write_potree),
    "navvis": Exporter(viewers.write_navvis),
    "colmap": Exporter(colmap.write, colmap.why_not),
    "colmap-rig": Exporter(colmap.write_rig),
    "opensfm": Exporter(reconstruction.write_opensfm, uses_place=True),
    "nerfstudio": Exporter(reconstruction.write_nerfstudio),
    "metashape": Exporter(reconstruction.write_metashape),
    "arcgis": Exporter(earth.write_arcgis, earth.why_not_in_arcgis, uses_grid=True),
    "stac": Exporter(earth.write_stac, uses_grid=True),
    "e57": Exporter(e57.write, e57.why_not),
    "gpano": Exporter(gpano.write, gpano.why_not),
    "ros": Exporter(robots.write_ros, spheres_only=False),
    "tum": Exporter(robots.write_tum, spheres_only=False),
    "gltf": Exporter(viewers.write_gltf, spheres_only=False),
    "psv": Exporter(web_tours.write_psv),
    "pannellum": Exporter(web_tours.write_pannellum),
    "geojson": Exporter(earth.write_geojson, spheres_only=False),
}


def export(format_name: ExportFormat, tour: Tour) -> Iterator[ExportedFile]:
    """Yield the files of a tour in a format, then `unplaced.txt` and `export.json`, which say what is left out and why.

    Panoramas that were converted are among them, for formats that only name files. Files are made one by one, so that at most one is in
    memory. Raises ExportRefusedError for a map without a georeference where the format needs one.
    """
    exporter = EXPORTERS[format_name]
    if format_name in FORMATS_ON_EARTH and tour.georeference is None and tour.coordinate_system is None:
        raise ExportRefusedError(
            f"{format_name}: expected a map with a georeference or a coordinate system, because this format holds "
            f"places on Earth, got a map with neither; set one of them, or choose another format"
        )
    held = _held(exporter, tour)
    written = set()
    for file in exporter.write(held):
        written.add(file.path)
        yield file
    for photo in held.photos:
        if photo.is_converted and photo.image is not None and photo.name not in written:
            yield ExportedFile(photo.name, photo.image)
    lines = "".join(f"{display_name(each.name)}\t{each.reason}\n" for each in held.left_out)
    lines += f"{tour.lacks}\n" if tour.lacks else ""
    yield ExportedFile("unplaced.txt", lines.encode(errors="surrogateescape"))
    summary = {
        "format": format_name,
        "map": tour.name,
        "north": north_of(format_name, tour),
        "num_photos": len(held.photos),
        "placed_by_hand": [photo.name for photo in held.photos if photo.is_by_hand],
        "lacks": tour.lacks,
        "left_out": [{"name": each.name, "reason": each.reason} for each in held.left_out],
    }
    yield ExportedFile("export.json", (json.dumps(summary, indent=1) + "\n").encode())


def north_of(format_name: ExportFormat, tour: Tour) -> North:
    """Return what headings and axes of an export refer to: the map's axes, those of its grid, or true north."""
    exporter = EXPORTERS[format_name]
    if format_name in FORMATS_ON_EARTH and not (exporter.uses_grid and earth.grid_of(tour) is not None):
        return "true"
    has_system = tour.georeference is None and tour.coordinate_system is not None
    if exporter.uses_place and (has_system or tour.georeference is not None):
        return "true"
    return "grid" if has_system else "map"


def _held(exporter: Exporter, tour: Tour) -> Tour:
    """Return the tour without the photos that the format cannot hold; these are left out with a reason."""
    judged = [(photo, _why_not(exporter, photo)) for photo in tour.photos]
    photos = tuple(photo for photo, reason in judged if reason is None)
    refused = [LeftOut(photo.name, reason) for photo, reason in judged if reason is not None]
    return replace(tour, photos=photos, left_out=(*tour.left_out, *refused))


def _why_not(exporter: Exporter, photo: PlacedPhoto) -> str | None:
    if not photo.name.isprintable():
        return "its name has characters that cannot be printed, or is not in UTF-8; rename it"
    if exporter.spheres_only and not photo.is_sphere:
        of_photos = ", ".join(name for name, each in EXPORTERS.items() if not each.spheres_only)
        return f"placed, but this format holds only full panoramas; formats of photos as well: {of_photos}"
    return None if exporter.why_not is None else exporter.why_not(photo)
