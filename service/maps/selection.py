"""The maps of a query: named by their ids, or by a tag."""

from dataclasses import dataclass

from panoloc.service.errors import InvalidOptionsError, MapNotFoundError, MapNotReadyError, MapUnusableError
from panoloc.service.jobs import MapRef
from panoloc.service.maps.known_maps import KnownMaps
from panoloc.service.maps.record import MapRecord

MAX_MAPS = 64
"""That one query searches."""
_RETRY_AFTER_S = 2


@dataclass(frozen=True)
class ChosenMaps:
    """Maps that can answer. warnings: about those that cannot."""

    refs: tuple[MapRef, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class MapChoice:
    """Either ids or a tag; see `from_form`."""

    map_ids: tuple[str, ...]
    tag: str | None
    tenant: str | None = None

    @classmethod
    def from_form(cls, map_ids: list[str], tags: list[str], tenant: str | None) -> "MapChoice":
        """Check the fields of a form. tenant: whose maps are meant, None for all. Raises InvalidOptionsError."""
        if bool(map_ids) == bool(tags):
            got = "both" if tags else "neither"
            raise invalid_option("map_id", f"expected either map_id (repeatable) or tag, got {got}; send one of them")
        if len(set(map_ids)) > MAX_MAPS:
            raise invalid_option(
                "map_id", f"expected at most {MAX_MAPS} maps, got {len(set(map_ids))}; name fewer maps"
            )
        return cls(tuple(dict.fromkeys(map_ids)), tags[0] if tags else None, tenant)

    def resolve(self, registry: KnownMaps) -> ChosenMaps:
        """Return the revisions that answer now.

        Every map that is named has to be ready; of a tag's maps those that are. Raises MapNotFoundError,
        MapNotReadyError and MapUnusableError.
        """
        seen = registry.seen_by(self.tenant)
        if self.tag is None:
            return ChosenMaps(tuple(serving_ref(seen.get(map_id)) for map_id in self.map_ids))
        tagged = seen.with_tag(self.tag)
        if not tagged:
            raise MapNotFoundError(
                f"expected the tag of a map, got {self.tag[:80]!r}; GET /maps and `panoloc maps` list the maps"
            )
        serving = [ref for record in tagged if (ref := record.serving_ref) is not None]
        if not serving:
            return ChosenMaps((serving_ref(tagged[0]),))
        if len(serving) > MAX_MAPS:
            raise invalid_option(
                "tag", f"expected at most {MAX_MAPS} maps, got {len(serving)} with this tag; name the maps"
            )
        left_out = [record.id for record in tagged if record.serving is None]
        return ChosenMaps(tuple(serving), tuple(f"{map_id} has the tag but is not ready" for map_id in left_out))


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


def invalid_option(name: str, message: str) -> InvalidOptionsError:
    """Return the error for one option."""
    return InvalidOptionsError(f"{name}: {message}", [{"field": name, "message": message}])
