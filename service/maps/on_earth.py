"""Maps by where they are on Earth, for queries that name none."""

import math
from dataclasses import dataclass

from panoloc.core.georeference import coordinate_system
from panoloc.service.errors import MapNotFoundError
from panoloc.service.maps.known_maps import VisibleMaps
from panoloc.service.maps.record import MapRecord, coordinate_system_of
from panoloc.service.maps.selection import MAX_MAPS, MapChoice, invalid_option

# Of a map around its known place, and of a device's error beyond the one that it states.
_REACH_M = 1000.0
_EARTH_RADIUS_M = 6_371_000.0


@dataclass(frozen=True)
class Place:
    """WGS 84. accuracy_m: of a device, by its own account."""

    latitude_deg: float
    longitude_deg: float
    accuracy_m: float = 0.0


def maps_around(maps: VisibleMaps, place: Place | None) -> MapChoice:
    """Return the maps that answer and have a place on Earth; place: only those within its accuracy plus a kilometre.

    Raises MapNotFoundError where there is none, and InvalidOptionsError for more than a query may name.
    """
    places = {record.id: place_of(record) for record in maps.all() if record.serving_ref is not None}
    known = {map_id: found for map_id, found in places.items() if found is not None}
    near = known
    if place is not None:
        reach_m = place.accuracy_m + _REACH_M
        near = {map_id: found for map_id, found in known.items() if distance_m(found, place) <= reach_m}
    if not near:
        where = "" if place is None else f" within {place.accuracy_m + _REACH_M:g} m of the geolocation"
        raise MapNotFoundError(
            f"expected a ready map with a place on Earth{where}, got none among {len(known)} maps; set a "
            f"georeference with PATCH /maps/{{id}}, or name a map as map_id"
        )
    if len(near) > MAX_MAPS:
        raise invalid_option(
            "map_id",
            f"expected at most {MAX_MAPS} maps to search, got {len(near)}; send a geolocation, or name maps as map_id",
        )
    return MapChoice(tuple(near), None, maps.tenant)


def place_of(record: MapRecord) -> Place | None:
    """Return where a map is: its georeference, else the middle of its scan in its coordinate system."""
    known = record.georeference
    if known is not None:
        return Place(known["latitude_deg"], known["longitude_deg"])
    system, stats = coordinate_system_of(record), None if record.serving is None else record.serving.stats
    if system is None or stats is None:
        return None
    lower, upper = stats["bounds"]["min"], stats["bounds"]["max"]
    x, y, z = ((low + high) / 2 for low, high in zip(lower, upper, strict=True))
    found = coordinate_system(system).place((x, y, z))
    return None if found is None else Place(found.latitude_deg, found.longitude_deg)


def distance_m(first: Place, second: Place) -> float:
    """Return metres between two places, on a sphere."""
    latitudes = math.radians(first.latitude_deg), math.radians(second.latitude_deg)
    across = math.radians(second.longitude_deg - first.longitude_deg)
    a = math.sin((latitudes[1] - latitudes[0]) / 2) ** 2
    b = math.cos(latitudes[0]) * math.cos(latitudes[1]) * math.sin(across / 2) ** 2
    return 2 * _EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(a + b)))
