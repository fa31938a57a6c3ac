"""The maps of a query: named by their ids or by a tag, all, or those near a place on Earth."""

import math
from dataclasses import dataclass

from panoloc.core.earth.georeference import coordinate_system, ecef_of
from panoloc.core.remarks import Remark
from panoloc.service.errors import InvalidOptionsError, MapNotFoundError, MapNotReadyError, MapUnusableError
from panoloc.service.jobs import MapRef
from panoloc.service.maps.known_maps import VisibleMaps
from panoloc.service.maps.record import MapRecord, coordinate_system_of

_RETRY_AFTER_S = 2
# Of a map around its known place, and of a device's error beyond the one that it states.
_REACH_M = 1000.0


@dataclass(frozen=True)
class ChosenMaps:
    """Maps that can answer. warnings: about those that cannot."""

    refs: tuple[MapRef, ...]
    warnings: tuple[Remark, ...] = ()


@dataclass(frozen=True)
class MapChoice:
    """Either ids or a tag, or neither: all maps; see `from_form`."""

    map_ids: tuple[str, ...]
    tag: str | None
    tenant: str | None = None

    @classmethod
    def from_form(
        cls, map_ids: list[str], tags: list[str], tenant: str | None, may_be_all: bool = False
    ) -> "MapChoice":
        """Check the fields of a form. tenant: whose maps are meant, None for all. may_be_all: whether a form need not name any.

        Raises InvalidOptionsError.
        """
        if (map_ids and tags) or not (map_ids or tags or may_be_all):
            got, or_else = "both", ""
            if not tags:
                got, or_else = "neither", "; with PANOLOC_SEARCH_ALL queries that name none search all maps"
            raise InvalidOptionsError.of(
                "map_id", f"expected either map_id (repeatable) or tag, got {got}; send one of them{or_else}"
            )
        return cls(tuple(dict.fromkeys(map_ids)), tags[0] if tags else None, tenant)

    def resolve(self, registry: VisibleMaps) -> ChosenMaps:
        """Return the revisions that answer now.

        Every map that is named has to be ready; of all maps, or those of a tag, the ones that are. Raises MapNotFoundError,
        MapNotReadyError and MapUnusableError.
        """
        seen = registry.seen_by(self.tenant)
        if self.map_ids:
            return ChosenMaps(tuple(serving_ref(seen.get(map_id)) for map_id in self.map_ids))
        meant = seen.all() if self.tag is None else seen.with_tag(self.tag)
        if not meant:
            expected = "a map to search, got none" if self.tag is None else f"the tag of a map, got {self.tag[:80]!r}"
            raise MapNotFoundError(f"expected {expected}; see the list of maps (GET /maps, panoloc maps)")
        serving = [ref for record in meant if (ref := record.serving_ref) is not None]
        if not serving:
            return ChosenMaps((serving_ref(meant[0]),))
        left_out = [record.id for record in meant if record.serving is None]
        if self.tag is not None:
            words = [f"{map_id} has the tag but is not ready" for map_id in left_out]
        else:
            words = [f"{len(left_out)} of {len(meant)} maps are not ready and were not searched"] if left_out else []
        return ChosenMaps(tuple(serving), tuple(Remark("map_not_ready", each) for each in words))


def serving_ref(record: MapRecord) -> MapRef:
    """Return the revision that answers now. Raises MapNotReadyError and MapUnusableError."""
    ref = record.serving_ref
    if ref is not None:
        return ref
    if record.newest.status == "failed":
        reason = (record.newest.error or {}).get("detail", "see its error")
        raise MapUnusableError(f"expected a ready map, but {record.id} failed: {reason}")
    raise MapNotReadyError(
        f"expected a ready map, but {record.id} is still being built; poll GET /maps/{record.id}",
        _RETRY_AFTER_S,
    )


@dataclass(frozen=True)
class Place:
    """WGS 84. accuracy_m: of a device, by its own account."""

    latitude_deg: float
    longitude_deg: float
    accuracy_m: float = 0.0

    def distance_m(self, other: "Place") -> float:
        """Return metres to another place, in a straight line."""
        ends = (ecef_of(each.latitude_deg, each.longitude_deg, 0.0) for each in (self, other))
        return math.dist(*ends)


def maps_around(maps: VisibleMaps, place: Place | None) -> MapChoice:
    """Return the maps that answer and have a place on Earth; place: only those within its accuracy plus a kilometre.

    Raises MapNotFoundError where there is none.
    """
    places = {record.id: place_of(record) for record in maps.all() if record.serving_ref is not None}
    known = {map_id: found for map_id, found in places.items() if found is not None}
    near = known
    if place is not None:
        reach_m = place.accuracy_m + _REACH_M
        near = {map_id: found for map_id, found in known.items() if found.distance_m(place) <= reach_m}
    if not near:
        where = "" if place is None else f" within {place.accuracy_m + _REACH_M:g} m of the geolocation"
        raise MapNotFoundError(
            f"expected a ready map with a place on Earth{where}, got none among {len(known)} maps; set a "
            "georeference with PATCH /maps/{id}, or name a map as map_id"
        )
    return MapChoice(tuple(near), None, maps.tenant)


def place_of(record: MapRecord) -> Place | None:
    """Return where a map is: its georeference, else the middle of its scan in its coordinate system."""
    known, system, middle = record.georeference, coordinate_system_of(record), _middle_of(record)
    if known is not None:
        return Place(known["latitude_deg"], known["longitude_deg"])
    found = None if system is None or middle is None else coordinate_system(system).place(middle)
    return None if found is None else Place(found.latitude_deg, found.longitude_deg)


def check_in_its_system(record: MapRecord) -> None:
    """Raise InvalidOptionsError where a map is placed by a coordinate system that its scan lies outside of."""
    middle, text = _middle_of(record), record.coordinate_system
    if text is None or middle is None or record.georeference is not None:
        return
    system = coordinate_system(text)
    if system.place(middle) is None:
        raise InvalidOptionsError.of(
            "coordinate_system", f"expected that of the scan, got {system.name}: {system.why_outside(middle)}"
        )


def _middle_of(record: MapRecord) -> tuple[float, float, float] | None:
    """Return the middle of the scan that answers, metres; None while there is none."""
    if record.serving is None or record.serving.stats is None:
        return None
    bounds = record.serving.stats["bounds"]
    x, y, z = ((low + high) / 2 for low, high in zip(bounds["min"], bounds["max"], strict=True))
    return x, y, z
