"""One position of a map: in its own frame, on the grid of its coordinate system, and on WGS 84."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import Field

from panoloc.core.earth.georeference import CoordinateSystem, EarthPlace, HeightReference, Position, coordinate_system
from panoloc.service.answer import ResponseModel
from panoloc.service.maps.control import ControlPoints

if TYPE_CHECKING:
    from panoloc.core.earth.geopose import EarthPose

_UNITS = {1.0: "m", 0.3048: "ft", 1200 / 3937: "ftUS"}


class GridPosition(ResponseModel):
    """A position on the grid of the map's coordinate system, in the unit of that."""

    coordinate_system: str
    name: str
    east: float
    north: float
    unit: str
    height_m: float | None = Field(
        description="Height in the system: of a map with a georeference above the geoid, null without `geoid_undulation_m`."
    )


class EarthPosition(ResponseModel):
    """A position on WGS 84."""

    latitude_deg: float
    longitude_deg: float
    height_m: float
    height_reference: HeightReference = Field(description="What `height_m` is above.")


class Coordinates(ResponseModel):
    """A position of a map in the systems that are known of it."""

    position_m: list[float] = Field(min_length=3, max_length=3)
    grid: GridPosition | None = Field(
        description="In the `coordinate_system` of the map; of a map with a `georeference` in that of its control points; null without one."
    )
    wgs84: EarthPosition | None = Field(description="Null for a map without a place on Earth, and outside of its grid.")


def coordinates_of(on_earth: Mapping[str, Any], control: ControlPoints, position_m: Position) -> dict[str, Any]:
    """Return a `Coordinates` document. Blocking: the first of a grid takes a tenth of a second.

    on_earth: values of `panoloc.service.jobs.ON_EARTH`. control: the control points of the map.
    """
    grid: dict[str, Any] | None = None
    place: EarthPlace | EarthPose | None = None
    if (origin := on_earth["georeference"]) is not None:
        # Loaded only where needed.
        import numpy as np

        from panoloc.core.earth.geopose import Georeference, earth_pose
        from panoloc.core.geometry.pose import Pose

        place = earth_pose(Georeference(**origin), Pose(np.eye(3), np.array(position_m)))
        if control.coordinate_system is not None:
            system = coordinate_system(control.coordinate_system)
            undulation_m = (
                on_earth["geoid_undulation_m"] if control.geoid_undulation_m is None else control.geoid_undulation_m
            )
            height = None if undulation_m is None else place.height_m - undulation_m
            grid = _on_grid(system, system.grid_position(place.latitude_deg, place.longitude_deg), height)
    elif (text := on_earth["coordinate_system"]) is not None:
        system = coordinate_system(text)
        east, north = (value / system.metres_per_unit for value in position_m[:2])
        grid = _on_grid(system, (east, north), position_m[2])
        place = system.place(position_m, on_earth["geoid_undulation_m"])
    wgs84 = place and {name: getattr(place, name) for name in EarthPosition.model_fields}
    return {"position_m": list(position_m), "grid": grid, "wgs84": wgs84}


def _on_grid(
    system: CoordinateSystem, position: tuple[float, float] | None, height_m: float | None
) -> dict[str, Any] | None:
    """Return a `GridPosition` document. position: east and north in the unit of the grid."""
    if position is None:
        return None
    unit = next((name for size, name in _UNITS.items() if abs(size - system.metres_per_unit) < 1e-9), "units")
    return {
        "coordinate_system": system.definition,
        "name": system.name,
        **dict(zip(("east", "north"), position, strict=True)),
        "unit": unit,
        "height_m": height_m,
    }
