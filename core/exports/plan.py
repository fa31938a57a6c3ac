"""Plans of the floors for CAD and GIS: DXF, SVG and GeoTIFF, each a section 1.2 m above the floor with the photos in it."""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from panoloc.core.earth.georeference import coordinate_system
from panoloc.core.exports.floor_plan import Array, Storey, draw_storey, points_of, section_of, storeys_of
from panoloc.core.exports.geotiff import geotiff
from panoloc.core.exports.tour import ExportedFile, Tour, plain
from panoloc.core.exports.wall_lines import wall_lines
from panoloc.core.scan.file_names import display_name

_METRE, _FOOT, _SURVEY_FOOT = 6, 2, 21  # $INSUNITS of DXF
_ARROW_M, _TEXT_M, _DOT_M = 0.6, 0.2, 0.08
_MARGIN_M = 0.5
_MM_PER_M = 10  # of SVG: a scale of 1 : 100


@dataclass(frozen=True)
class FloorDrawing:
    """One floor as lines. layer: its name. level: of the floor. walls: (S, 2, 2); rest: (M, 2), of the section, on no wall.

    photos: name, position (3,) and where its arrow ends (2,). All in the units of the map's grid, metres without one.
    """

    layer: str
    level: float
    walls: Array
    rest: Array
    photos: tuple[tuple[str, Array, Array], ...]


def write(tour: Tour) -> Iterator[ExportedFile]:
    """Yield `plan.dxf` with all floors, and `plan-N.svg` and `plan-N.tif` per floor.

    DXF and GeoTIFF have the coordinates of the map, or of its grid in the grid's unit; the GeoTIFF of a map with a georeference lies in a
    transverse Mercator projection about the map's origin.
    """
    points = points_of(tour)
    storeys = storeys_of(tour.photos, tour.floor_levels_m, points)
    unit_m = _metres_per_unit(tour)
    drawings = []
    for number, storey in enumerate(storeys, 1):
        drawing = _drawing(tour, storey, number, *wall_lines(section_of(storey, points).positions[:, :2]), unit_m)
        drawings.append(drawing)
        yield ExportedFile(f"plan-{number}.svg", _svg(drawing, unit_m).encode())
        yield from geotiff(f"plan-{number}", draw_storey(storey, tour.photos, points), tour)
    yield ExportedFile("plan.dxf", _dxf(drawings, unit_m))


def _metres_per_unit(tour: Tour) -> float:
    if tour.georeference is not None or tour.coordinate_system is None:
        return 1.0
    return coordinate_system(tour.coordinate_system).metres_per_unit


def _drawing(tour: Tour, storey: Storey, number: int, walls: Array, rest: Array, unit_m: float) -> FloorDrawing:
    photos = []
    for photo in (tour.photos[number] for number in storey.photos):
        at, ahead = photo.map_from_camera.position, photo.map_from_camera.rotation[:2, 0]
        level = float(np.hypot(*ahead))
        tip = at[:2] + (_ARROW_M * ahead / level if level > 1e-6 else 0.0)  # straight up and down have no heading
        photos.append((display_name(photo.name), at / unit_m, tip / unit_m))
    return FloorDrawing(f"FLOOR-{number}", storey.level_m / unit_m, walls / unit_m, rest / unit_m, tuple(photos))


def _dxf(drawings: list[FloorDrawing], unit_m: float) -> bytes:
    """Return a DXF of AutoCAD 2010 with three layers per floor: walls, rest of the section, photos."""
    from ezdxf.filemanagement import new

    document = new("R2010")
    document.header["$INSUNITS"] = {1.0: _METRE, 0.3048: _FOOT}.get(unit_m, _SURVEY_FOOT)
    document.header["$MEASUREMENT"] = int(unit_m == 1.0)
    space = document.modelspace()
    for drawing in drawings:
        walls, rest, photos = (f"{drawing.layer}-{name}" for name in ("WALLS", "SECTION", "PHOTOS"))
        for layer, color in ((walls, 7), (rest, 8), (photos, 5)):
            document.layers.add(layer, color=color)
        z = drawing.level
        for start, end in drawing.walls.tolist():
            space.add_line((*start, z), (*end, z), {"layer": walls})
        for place in drawing.rest.tolist():
            space.add_point((*place, z), {"layer": rest})
        for name, at, tip in drawing.photos:
            space.add_point(at.tolist(), {"layer": photos})
            space.add_line(at.tolist(), (*tip.tolist(), float(at[2])), {"layer": photos})
            text = {"layer": photos, "height": _TEXT_M / unit_m, "insert": (at[0] + _DOT_M / unit_m, *at[1:])}
            space.add_text(name.encode(errors="replace").decode(), dxfattribs=text)
    out = io.StringIO()
    document.write(out)
    return out.getvalue().encode()


def _svg(drawing: FloorDrawing, unit_m: float) -> str:
    """Return a drawing at 1 : 100 whose user unit is the metre; `data-x` and `data-y` are exact coordinates of the map or grid."""
    walls, rest = drawing.walls.reshape(-1, 2) * unit_m, drawing.rest * unit_m
    places = [np.concatenate([at[:2], tip]).reshape(2, 2) * unit_m for _, at, tip in drawing.photos]
    everything = np.concatenate([walls, rest, *places, *([np.zeros((1, 2))] if not places and not len(walls) else [])])
    left, bottom = everything.min(axis=0) - _MARGIN_M
    right, top = everything.max(axis=0) + _MARGIN_M

    def at(place: Any) -> str:
        """Return metres from the left and the top of the drawing."""
        return f"{plain(float(place[0]) - left, 3)} {plain(top - float(place[1]), 3)}"

    size = right - left, top - bottom
    lines = " ".join(f"M{at(start)}L{at(end)}" for start, end in walls.reshape(-1, 2, 2))
    dots = " ".join(f"M{at(place)}h0" for place in rest)
    photos = "\n".join(
        f'<g data-x="{plain(position[0], 4)}" data-y="{plain(position[1], 4)}"><title>{escape(name)}</title>'
        f'<path d="M{at(place)}L{at(tip)}"/><path d="M{at(place)}h0" stroke-width="{2 * _DOT_M}"/>'
        f'<text x="{at(place).split()[0]}" y="{at(place).split()[1]}" dx="{1.5 * _DOT_M}">{escape(name)}</text></g>'
        for (name, position, _), (place, tip) in zip(drawing.photos, places, strict=True)
    )
    corner = (
        f'data-left="{plain(left / unit_m, 4)}" data-top="{plain(top / unit_m, 4)}" data-metres-per-unit="{unit_m!r}"'
    )
    return f"""<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {plain(size[0], 3)} {plain(size[1], 3)}" \
width="{plain(size[0] * _MM_PER_M, 2)}mm" height="{plain(size[1] * _MM_PER_M, 2)}mm" {corner}>
<title>{drawing.layer}, 1 : 100</title>
<g id="section" stroke="#9aa0aa" stroke-width="0.03" stroke-linecap="round" fill="none"><path d="{dots}"/></g>
<g id="walls" stroke="#15181d" stroke-width="0.04" stroke-linecap="round" fill="none"><path d="{lines}"/></g>
<g id="photos" stroke="#2b57d9" stroke-width="0.04" stroke-linecap="round" fill="none" font-family="sans-serif" font-size="{_TEXT_M}">
<style>text {{ fill: #2b57d9; stroke: none; }}</style>
{photos}
</g>
</svg>
"""
